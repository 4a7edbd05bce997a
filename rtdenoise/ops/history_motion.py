"""The motion that fetches history, tested against the screen and against uncovered regions."""

from __future__ import annotations

import torch
from torch import Tensor

from .dispatch import Fused, Support

FUSED = Fused("history_motion", native=Support())


def history_motion(
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, previous minus current
    motion_next_previous: Tensor,  # [B, 2, H, W] next minus current, of the previous frame
    threshold: float,  # pixels between dual and traditional motion that make a pixel uncovered
) -> tuple[Tensor, Tensor, Tensor]:  # [B, 2, H, W], [B, 1, H, W] bool, [B, 1, H, W] bool
    """`motion.dual_motion` inside uncovered regions (`motion.occlusion_mask`) and `motion` elsewhere; whether it leads
    onto the screen (`motion.on_screen`); and whether the pixel is uncovered."""
    if run := FUSED(motion=motion, motion_next_previous=motion_next_previous):
        return run(motion, motion_next_previous, threshold)
    from ..motion import dual_motion, occlusion_mask, on_screen  # which imports this package

    dual = dual_motion(motion, motion_next_previous)
    uncovered = occlusion_mask(dual, motion, threshold)
    motion = torch.where(uncovered, dual, motion)
    return motion, on_screen(motion), uncovered
