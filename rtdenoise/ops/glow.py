"""Surfaces that shine by themselves. Their samples have no noise, and kernels spread their light around them.

Cycles writes their light as albedo: above GLOWS it is that, and within GLOW_REACH pixels along either axis there may be
some of it.
"""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F

from ..constants import GLOW_REACH, GLOWS
from .fetch import fetch
from .pixels import within


def away_from_glow(
    share: Tensor,  # [B, 1, H, W]
    albedo: Tensor,  # [B, 3, H, W] of the frame
) -> Tensor:  # [B, 1, H, W]
    """`share`, but 0 beside what shines. On a CPU `share` itself where nothing does."""
    return share if _is_dark(albedo) else share * (_most(albedo) <= GLOWS)


def left_by_glow(
    shown: Tensor,  # [B, 1, H, W] bool
    albedo: Tensor,  # [B, 3, H, W] of the frame
    before: Tensor,  # [B, 3, H, W] of the frame before
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, to that frame
) -> Tensor:  # [B, 1, H, W] bool
    """`shown`, but False where the frame before had something that shines beside a pixel, and this frame has not: its
    picture has spread that light there. On a CPU `shown` itself where nothing shone."""
    return shown if _is_dark(before) else shown & ((fetch(_most(before), motion) <= GLOWS) | (_most(albedo) > GLOWS))


def _most(albedo: Tensor) -> Tensor:
    """The greatest albedo beside a pixel, `[B, 1, H, W]`."""
    return F.max_pool2d(albedo.amax(1, keepdim=True), 2 * GLOW_REACH + 1, stride=1, padding=GLOW_REACH)


def _is_dark(albedo: Tensor) -> bool:
    """Whether nothing shines; a GPU is not waited for."""
    return albedo.device.type == "cpu" and within(albedo, 0.0, GLOWS)
