"""How much less lookups off the pixel count in `recall`: the less noise, the more."""

from __future__ import annotations

from torch import Tensor

from ..constants import RECALL_MISPLACED, RECALL_MISPLACED_MORE, RECALL_NOISY
from .dispatch import Fused, Support, falls_back

FUSED = Fused("off_pixel", triton=Support(channels={"noise": (1,)}))


@falls_back
def off_pixel(noise: Tensor, more: bool = False) -> Tensor:
    """`recall`'s `misplaced` from `exposure.noise_level`, `[B, 1, 1, 1]` each. `more`: that of `Frame.more_history`."""
    share = RECALL_MISPLACED_MORE if more else RECALL_MISPLACED
    if run := FUSED(noise=noise):
        return run(noise, share)
    return share * (1 / noise.clamp(min=1e-6) - 1 / RECALL_NOISY).clamp(min=0)
