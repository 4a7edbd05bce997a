"""The scale of a scene."""

from __future__ import annotations

from torch import Tensor

from ..constants import MIN_DISTANCE
from .dispatch import Fused, Support, falls_back

FUSED = Fused("mean_distance", triton=Support(channels={"depth": (1,)}))


@falls_back
def mean_distance(depth: Tensor) -> Tensor:
    """Mean of the depths that are not 0, `[B, 1, H, W] -> [B, 1, 1, 1]`; never zero."""
    if run := FUSED(depth=depth):
        return run(depth)
    hits = (depth > 0).sum((1, 2, 3), keepdim=True).clamp(min=1)
    return (depth.sum((1, 2, 3), keepdim=True) / hits).clamp(min=MIN_DISTANCE)
