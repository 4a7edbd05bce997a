"""Statistics of some thousand values by their rank: of the blocks and windows of a frame (`exposure`)."""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import BRIGHTNESS_TENTHS, MIN_BRIGHTNESS
from .dispatch import Fused, Support, falls_back

KTH_GREATEST = Fused("ranks.kth_greatest", triton=Support())
EXPOSURE_OF = Fused("ranks.exposure_of", triton=Support())
MEDIAN = Fused("ranks.median", triton=Support())
MAX_VALUES = 1 << 20  # of an image: the fused ops count them in 21 bits


@falls_back
def kth_greatest(values: Tensor, k: int) -> Tensor:
    """The k-th greatest of each row's values, `[B, N] -> [B, 1]`."""
    if values.shape[1] <= MAX_VALUES and (run := KTH_GREATEST(values=values)):
        return run(values, k)
    return values.topk(k, dim=1).values[:, -1:]


@falls_back
def exposure_of(means: Tensor) -> Tensor:
    """One over the mean of the lowest `BRIGHTNESS_TENTHS` of each row's values, `[B, N] -> [B, 1, 1, 1]`; that is
    `MIN_BRIGHTNESS` at least. Of values that are 0 only as many count as there are others, and one other does at
    least."""
    if means.shape[1] <= MAX_VALUES and (run := EXPOSURE_OF(means=means)):
        return run(means)
    N = means.shape[1]
    black = (means <= 0).sum(dim=1, keepdim=True)
    left_out = (2 * black - N).clamp(min=0)
    count = ((N - left_out) * BRIGHTNESS_TENTHS // 10).maximum(black.minimum(N - black) + 1)
    kept = torch.arange(N, device=means.device) < left_out + count
    total = torch.where(kept, means.sort(dim=1).values, 0.0).sum(dim=1, keepdim=True)
    return 1 / (total / count).clamp(min=MIN_BRIGHTNESS).reshape(-1, 1, 1, 1)


@falls_back
def median(values: Tensor) -> Tensor:
    """The lower median of each row's values, `[B, N] -> [B, 1, 1, 1]`, which are finite or NaN: NaN does not count, and
    where there is nothing else it is infinite."""
    if values.shape[1] <= MAX_VALUES and (run := MEDIAN(values=values)):
        return run(values)
    return values.nanmedian(1).values.nan_to_num(nan=torch.inf).view(-1, 1, 1, 1)
