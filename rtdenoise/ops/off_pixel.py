"""How much less lookups off the pixel count in `recall`: the less noise, the more."""

from __future__ import annotations

from torch import Tensor

from ..constants import RECALL_MISPLACED, RECALL_MISPLACED_MEAN, RECALL_NOISY
from .dispatch import Fused, Support, falls_back

FUSED = Fused("off_pixel", triton=Support(channels={"noise": (1,)}))


@falls_back
def off_pixel(noise: Tensor, mean: bool = False) -> Tensor:
    """`recall`'s `misplaced` from `exposure.noise_level`, `[B, 1, 1, 1]` each. `mean`: that of `Frame.mean_depth`."""
    share = RECALL_MISPLACED_MEAN if mean else RECALL_MISPLACED
    if run := FUSED(noise=noise):
        return run(noise, share)
    return share * (1 / noise.clamp(min=1e-6) - 1 / RECALL_NOISY).clamp(min=0)
