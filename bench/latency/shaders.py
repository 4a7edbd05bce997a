"""The whole frame as compute shaders: one pipeline on a frame that is on the GPU already."""

from __future__ import annotations

import numpy as np
import torch

from rtdenoise import glsl
from rtdenoise.constants import SOFTWARE_RENDERER
from rtdenoise.errors import InputError
from rtdenoise.frame import Frame
from rtdenoise.glsl import Clock, GpuArray, Pipeline
from rtdenoise.models import Denoiser

from .stages import STAGES

PRECISIONS = {"glsl fp32": (False, "frame"), "glsl fp16": (True, "frame, float16 activations")}
"""Method -> whether activations are stored as float16, row of tolerances.py for its comparison with torch."""

PREDICTION, KERNELS, BLENDING, REPROJECTION = STAGES
STAGE_OF = {"features": PREDICTION, "network": PREDICTION, "kernels": KERNELS, "blend": BLENDING,
            "reprojection": REPROJECTION, "pixels": PREDICTION}  # fmt: skip
"""Stage of the pipeline -> stage of the paper. The network's last layer counts as kernel application: logits are
computed where they are used. The edge kernel counts as blending here, because it runs in those passes; in torch's rows
it counts as kernel application."""


class Shaders:
    """One denoiser in one precision, with a frame and its history on the GPU."""

    def __init__(self, denoiser: Denoiser, frame: Frame, half: bool) -> None:
        tensors = {name: _array(tensor) for name, tensor in denoiser.state_dict().items()}
        self._pipeline = Pipeline(denoiser.config, tensors, half)
        self._ctx = self._pipeline.ctx
        self._layers = {name: GpuArray.upload(self._ctx, _array(t[0])) for name, t in frame.layers()}
        _, history = self._pipeline.run(self._layers)
        self._history = self._pipeline.remember(history, [frame.map(_array)] * denoiser.config.recent)

    def step(self) -> GpuArray:
        """One frame with history, from the GPU to the GPU; returns when it is done."""
        image, _ = self._pipeline.run(self._layers, self._history)
        self._ctx.finish()
        return image

    def image(self) -> np.ndarray:
        """`[1, 3, H, W]` of a step."""
        return self.step().read()[None]

    def stages(self) -> dict[str, float]:
        """Seconds of one step by stage of the paper, on a GPU by its own clock."""
        self._pipeline.clock = Clock(self._ctx)
        self.step()
        seconds, self._pipeline.clock = self._pipeline.clock.read(), None
        return {stage: sum(s for name, s in seconds.items() if STAGE_OF[name] == stage) for stage in STAGES}

    @property
    def megabytes(self) -> float:
        """GPU memory of a step: the frame, two histories, recent frames once, and the pipeline's scratch buffers."""
        kept = [a for a in vars(self._history).values() if isinstance(a, GpuArray)]
        arrays = [*self._layers.values(), *kept, *kept, *self._history.recent]
        return (sum(array.buffer.size for array in arrays) + self._pipeline.scratch.nbytes) / 1e6


def _array(tensor: torch.Tensor) -> np.ndarray:
    return tensor.float().cpu().numpy()


def renderer() -> str:
    """Name of the device that OpenGL runs on. Raises InputError where there is no OpenGL."""
    return glsl.default_context().info["GL_RENDERER"]


def measurable(quick: bool) -> tuple[bool, str]:
    """Whether to time shaders here; the device, or the reason why not. Software renderers take minutes per frame."""
    try:
        name = renderer()
    except InputError as error:
        return False, f"not measured: {error}"
    software = SOFTWARE_RENDERER in name
    return (quick or not software), name if quick or not software else f"not measured: {name} is no GPU"
