"""How much less lookups off the pixel count in `recall`: the less noise, the more."""

from __future__ import annotations

from torch import Tensor

from ..constants import RECALL_MISPLACED, RECALL_NOISY
from .dispatch import Fused, Support, falls_back

FUSED = Fused("off_pixel", triton=Support(channels={"noise": (1,)}))


@falls_back
def off_pixel(noise: Tensor) -> Tensor:
    """`recall`'s `misplaced` from `exposure.noise_level`, `[B, 1, 1, 1]` each."""
    if run := FUSED(noise=noise):
        return run(noise)
    return RECALL_MISPLACED * (1 / noise.clamp(min=1e-6) - 1 / RECALL_NOISY).clamp(min=0)
