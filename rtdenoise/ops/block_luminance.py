"""Luminance of square blocks of pixels, for statistics of a frame."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F

from ..color import luminance
from .dispatch import Fused, Support, falls_back

SUPPORT = Support(channels={"radiance": (3,)})
FUSED = Fused("block_luminance", native=SUPPORT, triton=SUPPORT)
MAX_BLOCK = 1024  # pixels: the widest block that the fused op takes


@falls_back
def block_luminance(
    radiance: Tensor,  # [B, 3, H, W]
    block: int,  # side in pixels; blocks at the right and lower border may be smaller
) -> tuple[Tensor, Tensor]:  # [B, N] each, N = ⌈H/block⌉ · ⌈W/block⌉, row by row
    """Mean and maximum of the luminance (`color.luminance`) of every block's pixels."""
    if block <= MAX_BLOCK and (run := FUSED(radiance=radiance)):
        return run(radiance, block)
    brightness = luminance(radiance)
    means = F.avg_pool2d(brightness, block, ceil_mode=True, count_include_pad=False)
    return means.flatten(1), F.max_pool2d(brightness, block, ceil_mode=True).flatten(1)
