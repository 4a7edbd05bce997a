"""What is around a pixel: in its cell of `AROUND_CELL` × `AROUND_CELL` pixels and in the eight cells around that."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import expand
from ..constants import AROUND_CELL
from .dispatch import Fused, Support, falls_back

IMAGES = dict.fromkeys(("compressed", "first", "other"), (3,))
SUPPORT = Support(channels=IMAGES)
FUSED = Fused("around.expand_within", native=SUPPORT, triton=SUPPORT)


def greatest_around(x: Tensor) -> Tensor:
    """The greatest values around each pixel, like `x`, `[B, C, H, W]`."""
    H, W = x.shape[2:]
    x = F.max_pool2d(F.max_pool2d(x, AROUND_CELL, ceil_mode=True), 3, stride=1, padding=1)
    return F.interpolate(x, scale_factor=AROUND_CELL, mode="nearest")[..., :H, :W]


@falls_back
def expand_within(
    compressed: Tensor,  # [B, 3, H, W] ≥ 0: log(1 + light)
    first: Tensor,  # [B, 3, H, W] a picture
    other: Tensor,  # [B, 3, H, W] another one
) -> Tensor:  # [B, 3, H, W]
    """The light, held between the least and the greatest value of both pictures around each pixel: where a network that
    writes pixels must stay, so that black stays black and even light even."""
    if run := FUSED(compressed=compressed, first=first, other=other):
        return run(compressed, first, other)
    with torch.no_grad():
        least = -greatest_around(-torch.minimum(first, other))
        most = greatest_around(torch.maximum(first, other))
    return expand(compressed).clamp(least, most)
