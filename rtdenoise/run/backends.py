"""The two backends that run a model: torch, or compute shaders without torch. Both take and return frames, images and
saved histories as numpy arrays."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..constants import RECALL_FRAMES, RECALL_RESET
from ..data.stored import of_resets, with_resets
from ..errors import INSTALL_TORCH, InputError
from ..frame import NOTHING_KNOWN, Frame, Known
from ..models.presets import Config
from .memory import explained
from .plan import Plan, count, look, make_plan

if TYPE_CHECKING:
    from torch import Tensor

    from ..models import Denoiser

BACKENDS = ("auto", "torch", "glsl")


class Backend(Protocol):
    """A model, ready to run. `history` is the backend's own; None starts anew."""

    @property
    def config(self) -> Config:
        """The configuration of its network."""

    @property
    def ran(self) -> dict[str, str]:
        """Its name, device and precision."""

    def plan(self, size: tuple[int, int], frames: int, first: list[Frame], left_out: dict[str, int]) -> Plan:
        """Follow the plan (`plan.make_plan`) from now on; `left_out` counts the frames that leave work out."""

    def prepare(self, frame: Frame) -> Frame:
        """A frame of arrays or tensors `[1, C, H, W]` as `mismatch` and `step` take it: shared work is done once."""

    def mismatch(self, frame: Frame, history: Any) -> float:
        """`history.mismatch` of a prepared frame: above `frame.MAX_CUT_MISMATCH` history belongs to another shot."""

    def step(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[np.ndarray, Any]:
        """Denoise a prepared frame: `[1, 3, H, W]`, and the history for the next one. `ahead`: `Known.ahead`."""

    def denoise(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[Any, Any]:
        """`step` with the image where the backend has it: a tensor on its device, or a numpy array."""

    def save(self, history: Any) -> dict[str, np.ndarray]:
        """A history as `frame.History.layers` names its fields, `[1, C, h, w]`: the same for every backend. Of recent
        frames only the resets (`data.stored`): all of them would be most of it, and the sequence has the rest."""

    def restore(self, fields: Mapping[str, np.ndarray]) -> Any:
        """The inverse of `save`. Raises InputError where the fields are not those of a history."""

    def remember(self, history: Any, frames: Sequence[Frame]) -> Any:
        """A restored history with what is not saved: the last `config.recent + 1` frames of the shot, prepared, the
        newest first. The oldest tells how light has moved to the one after it."""


def open_backend(
    name: str,
    model: str,
    device: str,
    precision: str,
    correct: bool = False,
    lookahead: int = 0,
) -> Backend:
    """The backend `name` with a model in it; 'auto' is torch where it is installed. With `correct` its images are
    corrected by the residuals of the frames before (`models.shrinkage.correct`). `lookahead`: as for `TorchBackend`.

    Raises InputError for an unknown name, a device, precision or correction that the backend lacks, and as `load` for
    the model.
    """
    if name not in BACKENDS:
        raise InputError(f"unknown backend {name!r}; expected one of {', '.join(BACKENDS)}")
    has_torch = find_spec("torch") is not None
    if name == "torch" and not has_torch:
        raise InputError(f"backend torch: PyTorch is not installed; {INSTALL_TORCH}, or use the backend glsl")
    if name == "torch" or (name == "auto" and has_torch):
        return TorchBackend(model, device, precision, correct, lookahead=lookahead)
    for chosen, what in ((correct, "the correction"), (lookahead, "lookahead")):
        if chosen:
            advice = "take the backend torch" if has_torch else INSTALL_TORCH
            raise InputError(f"{what} runs in PyTorch alone; {advice}, or leave it out")
    return GlslBackend(model, device, precision)


class TorchBackend:
    """`rtdenoise.models`."""

    def __init__(
        self,
        model: str,
        device: str,
        precision: str,
        correct: bool = False,
        footprint: bool = False,
        lookahead: int = 0,
    ) -> None:
        """`footprint`: the histories of a network that averages light have one, of `RECALL_FRAMES` frames. `lookahead`:
        frames that its steps will get `ahead`; networks that keep none then keep `RECALL_FRAMES`. Raises InputError
        where one cannot."""
        import torch

        from ..models import load
        from ..models.hybrid import Hybrid
        from ..models.inference import choose_device
        from .graphs import stepper

        self.device = choose_device(device)
        with torch.autocast(self.device, enabled=False):
            self._denoiser = load(model, self.device, precision)
        if correct and self._denoiser.config.motion is None:
            raise InputError(f"{model}: denoises single pictures, and the correction needs the frames before")
        averages = "mean" in self._denoiser.config.carries
        if lookahead and not averages:
            raise InputError(f"lookahead: model {model!r} does not average light over time; choose hybrid, default, "
                             "many or fast")  # fmt: skip
        self._correct = correct
        config = self._denoiser.config
        if averages and (footprint or (lookahead and not config.recent)):
            most = min(RECALL_FRAMES, math.ceil(config.longest) - 1)  # below the longest history
            self._denoiser.config = replace(config, recent=most, footprint=footprint or config.footprint)
            if isinstance(self._denoiser, Hybrid):
                self._denoiser.keeps_footprint = footprint
        self._step = self._whole = stepper(self._denoiser)
        self._lookahead = lookahead

    @property
    def config(self) -> Config:
        """The configuration of its network."""
        return self._denoiser.config

    @property
    def ran(self) -> dict[str, str]:
        from ..models.loading import precision_of

        return {"backend": "torch", "device": self.device, "precision": precision_of(self._denoiser)}

    @property
    def network(self) -> Denoiser:
        """Its network, a torch module."""
        return self._denoiser

    @contextmanager
    def _inference(self, frame: Frame) -> Iterator[None]:
        """Without gradients, and at the network's precision whatever the caller's autocast is."""
        import torch

        plain = torch.autocast(self.device, enabled=False)
        with torch.inference_mode(), plain, explained(frame.name, frame.size, self.device):
            yield

    def prepare(self, frame: Frame) -> Frame:
        import torch

        from ..sanitise import sanitise

        with self._inference(frame):
            return sanitise(frame.map(torch.as_tensor).to(self.device))

    def step(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[np.ndarray, Any]:
        image, history = self.denoise(frame, history, ahead)
        with self._inference(frame):
            return image.cpu().numpy(), history

    def denoise(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[Tensor, Any]:
        from ..models.shrinkage import corrected

        step = self._step if len(frame.radiance) == 1 else self._whole  # the plan is for single pictures
        step = corrected(step) if self._correct else step
        with self._inference(frame):
            return step(frame, history, Known(sanitised=True, ahead=ahead))

    def plan(self, size: tuple[int, int], frames: int, first: list[Frame], left_out: dict[str, int]) -> Plan:
        from .planned import Planned

        config = self._denoiser.config
        windows = config.network_reach is not None
        motion = "dual" if self._lookahead else config.motion  # frames after are led to by motion_next
        plan = make_plan(size, frames, motion, first, windows, config.reads)
        planned = Planned(self._denoiser, plan, self._whole)
        left_out |= planned.left_out | left_out  # the counts of earlier runs, where there are any
        planned.left_out, self._step = left_out, planned.step
        return plan

    def mismatch(self, frame: Frame, history: Any) -> float:
        from ..history import mismatch

        if self.config.motion is None:
            return 0.0  # history leaves no trace
        with self._inference(frame):
            return mismatch(frame, history).max().item()

    def save(self, history: Any) -> dict[str, np.ndarray]:
        layers = replace(history, recent=(), footprint=None, footprint_count=None, noisy=None).layers()
        fields = {name: tensor.cpu().contiguous().numpy() for name, tensor in layers.items()}
        resets = (kept[:, RECALL_RESET, None].cpu().contiguous().numpy() for kept in history.recent)
        return fields | of_resets(resets)

    def restore(self, fields: Mapping[str, np.ndarray]) -> Any:
        from ..history import from_arrays

        history = from_arrays(with_resets(fields), self.device)
        there = {name.partition(".")[0] for name in history.layers()}
        wanted = "depth", "normal", *self.config.carries, *(("residual", "residual_length") if self._correct else ())
        if missing := [name for name in wanted if name not in there]:
            raise InputError(f"the history has no {missing[0]}")
        return history

    def remember(self, history: Any, frames: Sequence[Frame]) -> Any:
        import torch

        from ..models.past import kept, shift_of

        if not frames or "mean" not in self.config.carries:
            return history
        with torch.inference_mode():
            recent = []
            for i, frame in enumerate(frames[: len(history.recent)]):
                shift = None
                if i + 1 < len(frames) and frame.motion is not None:
                    before = frames[i + 1]
                    shift = shift_of(frame, before.radiance, before.depth, history.shifts[i + 1 : i + 2])
                recent.append(kept(self.config, frame, torch.zeros_like(frame.depth), shift=shift))
            for its, resets in zip(recent, history.recent, strict=True):
                its[:, RECALL_RESET] |= resets[:, RECALL_RESET]
            return replace(history, noisy=frames[0].radiance, recent=tuple(recent))


class GlslBackend:
    """`rtdenoise.glsl.Pipeline`, on the GPU that OpenGL gives."""

    def __init__(self, model: str, device: str, precision: str) -> None:
        from ..glsl import Pipeline

        if device != "auto":
            raise InputError(f"device {device!r}: goes with the backend torch; the driver chooses where shaders run")
        if precision not in ("auto", "fp32", "fp16"):
            raise InputError(f"precision {precision!r}: the backend glsl has 'fp32' and 'fp16' ('auto' is fp32)")
        self._pipeline = Pipeline.load(model, half=precision == "fp16")
        self._precision = "fp16" if precision == "fp16" else "fp32"
        self._left_out: dict[str, int] | None = None  # None: nothing is left out

    @property
    def config(self) -> Config:
        return self._pipeline.config

    @property
    def ran(self) -> dict[str, str]:
        return {"backend": "glsl", "device": self._pipeline.ctx.info["GL_RENDERER"], "precision": self._precision}

    def plan(self, size: tuple[int, int], frames: int, first: list[Frame], left_out: dict[str, int]) -> Plan:
        self._left_out = left_out
        return make_plan(size, frames, self._pipeline.config.motion, first, windows=False)

    def prepare(self, frame: Frame) -> Frame:
        return frame.map(np.asarray)

    def mismatch(self, frame: Frame, history: Any) -> float:
        return self._pipeline.mismatch(frame, history[0])

    def step(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[np.ndarray, Any]:
        resident, motion_next = history or (None, None)
        known = NOTHING_KNOWN
        if self._left_out is not None:
            known = look(frame, motion_next, history is not None)
            count(self._left_out, known, self._pipeline.accumulates)
        image, resident = self._pipeline.step(frame, resident, known)
        return image, (resident, frame.motion_next)  # the next frame's plan needs this motion_next

    def denoise(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[np.ndarray, Any]:
        return self.step(frame, history)

    def save(self, history: Any) -> dict[str, np.ndarray]:
        resets = (kept.read_plane(RECALL_RESET)[None, None] for kept in history[0].recent)
        return replace(history[0], recent=(), noisy=None).read() | of_resets(resets)

    def restore(self, fields: Mapping[str, np.ndarray]) -> Any:
        from ..glsl import History

        return History.upload(self._pipeline.ctx, with_resets(fields)), fields.get("motion_next")

    def remember(self, history: Any, frames: Sequence[Frame]) -> Any:
        resident, motion_next = history
        return self._pipeline.remember(resident, frames), motion_next
