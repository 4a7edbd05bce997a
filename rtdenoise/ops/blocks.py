"""Luminance of whole blocks of pixels, for statistics of a frame."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F

from ..color import luminance
from .path import fused


def block_luminance(
    radiance: Tensor,  # [B, 3, H, W]
    block: int,  # side in pixels; at the right and the lower border there may be less of one
) -> tuple[Tensor, Tensor]:  # [B, N] each, N = ⌈H/block⌉ · ⌈W/block⌉, row by row
    """Mean and maximum of the luminance (`color.luminance`) of every block's pixels."""
    if run := fused("block_luminance", radiance):
        return run(radiance, block)
    brightness = luminance(radiance)
    means = F.avg_pool2d(brightness, block, ceil_mode=True, count_include_pad=False)
    return means.flatten(1), F.max_pool2d(brightness, block, ceil_mode=True).flatten(1)
