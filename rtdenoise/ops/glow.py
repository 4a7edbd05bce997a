"""Surfaces that shine by themselves. Their samples have no noise, and kernels spread their light around them."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F

from ..constants import GLOW_REACH, GLOWS


def away_from_glow(
    share: Tensor,  # [B, 1, H, W]
    albedo: Tensor,  # [B, 3, H, W] of the frame
) -> Tensor:  # [B, 1, H, W]
    """`share`, but 0 within GLOW_REACH pixels along either axis of albedo above GLOWS, as Cycles writes it of lamps and
    sparks: there it is their light. On a CPU `share` itself where nothing shines."""
    if albedo.device.type == "cpu" and not (albedo > GLOWS).any():
        return share
    most = F.max_pool2d(albedo.amax(1, keepdim=True), 2 * GLOW_REACH + 1, stride=1, padding=GLOW_REACH)
    return share * (most <= GLOWS)
