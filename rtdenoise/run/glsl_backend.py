"""The backend that runs a model as compute shaders, without torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..constants import RECALL_RESET
from ..data.stored import of_resets, with_resets
from ..errors import InputError
from ..frame import NOTHING_KNOWN, Frame
from ..models.presets import Config
from .plan import Plan, count, look, make_plan


class GlslBackend:
    """A `backends.Backend` of `rtdenoise.glsl.Pipeline`, on the GPU that OpenGL gives."""

    settles = False  # it looks at no frames ahead

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
