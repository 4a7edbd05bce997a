"""The two backends that run a model: torch, or compute shaders without torch. Both take and return frames, images and
saved histories as numpy arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np

from ..errors import INSTALL_TORCH, InputError
from ..frame import Frame
from ..models.presets import Config
from .glsl_backend import GlslBackend
from .plan import Plan
from .torch_backend import TorchBackend

BACKENDS = ("auto", "torch", "glsl")


class Backend(Protocol):
    """A model, ready to run. `history` is the backend's own; None starts anew."""

    @property
    def config(self) -> Config:
        """The configuration of its network."""

    @property
    def ran(self) -> dict[str, str]:
        """Its name, device and precision."""

    @property
    def settles(self) -> bool:
        """Whether a picture is finished by that of the next frame of its shot (`settled`), of those that look ahead."""

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

    def settled(self, frame: Frame, after: Any, following: Frame, after_following: Any) -> Any:
        """The image of a frame once the next one of its shot is denoised, too, as `denoise` returns it; only where the
        backend `settles`. `after`, `after_following`: the histories that both left."""

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
