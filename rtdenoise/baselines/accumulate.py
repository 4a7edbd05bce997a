"""Plain temporal accumulation (the paper's eq. 1): a running mean along traditional motion, and no filter."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..frame import Frame, History, image_of
from ..motion import on_screen
from ..ops import blend, fetch, warp
from ..sanitise import sanitise
from .clamp import clamp_to_neighbourhood


@dataclass(frozen=True)
class Accumulate:
    """`out = a · noisy + (1 - a) · history`, a = max(1 / n, α) in the n-th frame of a pixel; pixels that were off
    the screen start anew."""

    alpha: float = 0.1
    clamp: float | None = None  # k: history is clamped to mean ± k·σ of the noisy window; None: not clamped
    window: int = 5  # its side in pixels, odd

    def step(self, frame: Frame, history: History | None = None) -> tuple[Tensor, History]:
        """As `TemporalKPN.step`; features are not needed."""
        frame = sanitise(frame)
        output, length = frame.radiance, torch.ones_like(frame.radiance[:, :1])
        if (previous := image_of(history)) is not None:
            frame.require("motion", previous=previous)
            length = torch.where(on_screen(frame.motion), fetch(history.length, frame.motion), 0.0) + 1
            warped = warp(history.radiance, frame.motion)
            if self.clamp is not None:
                warped = clamp_to_neighbourhood(warped, frame.radiance, self.clamp, self.window)
            output = blend(frame.radiance, warped, (1 / length).clamp(min=self.alpha))
        return output, History(output, frame.motion_next, frame.depth, frame.normal, length)
