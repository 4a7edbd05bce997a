"""D of eq. 4: 2×2 pooling."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F

from .dispatch import Fused, Support, falls_back

FUSED = Fused("downsample", native=Support(), triton=Support())


@falls_back
def downsample(
    image: Tensor,  # [B, C, H, W]
    pool: str = "mean",
) -> Tensor:  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    """D of eq. 4: `out[b,c,y,x] = mean or max of image[b, c, 2y..2y+1, 2x..2x+1]`.

    At an odd border a cell holds only the pixels that exist. The paper prints max pooling; on unbounded Monte Carlo
    noise the maximum is biased upwards, so `mean` is the default. `nearest` takes image[b, c, 2y, 2x], as MLTD's
    authors do (Chen et al. 2024): three pixels of four are not seen. Raises ValueError for another `pool`.
    """
    if pool not in ("mean", "max", "nearest"):
        raise ValueError(f"expected pool 'mean', 'max' or 'nearest', got {pool!r}")
    if pool == "nearest":
        return image[:, :, ::2, ::2]
    if run := FUSED(image=image):
        return run(image, pool)
    if pool == "mean":
        return F.avg_pool2d(image, 2, ceil_mode=True, count_include_pad=False)
    return F.max_pool2d(image, 2, ceil_mode=True)
