"""Between the scales, and between space and time: D, U, eq. 4 and the final blend."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from .path import fused


def downsample(
    image: Tensor,  # [B, C, H, W]
    pool: str = "mean",
) -> Tensor:  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    """D of eq. 4: 2×2 pooling, `out[b,c,y,x] = mean or max of image[b, c, 2y..2y+1, 2x..2x+1]`.

    At an odd border the cell holds what exists of it. The paper prints max pooling; on unbounded Monte Carlo noise the
    maximum is biased upwards, so `mean` is the default. Raises ValueError for another `pool`.
    """
    if pool not in ("mean", "max"):
        raise ValueError(f"expected pool 'mean' or 'max', got {pool!r}")
    if run := fused("downsample", image):
        return run(image, pool)
    if pool == "mean":
        return F.avg_pool2d(image, 2, ceil_mode=True, count_include_pad=False)
    return F.max_pool2d(image, 2, ceil_mode=True)


def upsample(
    image: Tensor,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    size: tuple[int, int],  # (H, W)
) -> Tensor:  # [B, C, H, W]
    """U of eq. 4: bilinear ×2 on the same geometry as `downsample`.

    Fine pixel x samples the coarse row at u = clamp((x + ½)/2 - ½, 0, ·): weights ¾ and ¼, borders repeated. Odd sizes
    crop the last row or column. Raises ValueError where `size` is not that of the finer level.
    """
    H, W = size
    if tuple(image.shape[2:]) != ((H + 1) // 2, (W + 1) // 2):
        raise ValueError(
            f"expected a coarse image of {(H + 1) // 2}×{(W + 1) // 2} for {H}×{W}, got {tuple(image.shape[2:])}"
        )
    return F.interpolate(image, scale_factor=2, mode="bilinear", align_corners=False)[:, :, :H, :W]


def compose(
    fine: Tensor,  # [B, C, H, W] filtered at this scale
    coarse: Tensor,  # [B, C, ⌈H/2⌉, ⌈W/2⌉] filtered and composed at the next coarser one
    alpha: Tensor,  # [B, 1, ⌈H/2⌉, ⌈W/2⌉] in [0, 1], on the coarse grid
    pool: str = "mean",
) -> Tensor:  # [B, C, H, W]
    """Replace the low frequencies of `fine` by those of `coarse`, as far as α says (eq. 4, after Vogels et al. 2018):

    o = fine - U[α · D fine] + U[α · coarse]

    Raises ValueError where the sizes do not fit.
    """
    B, C, H, W = fine.shape
    expected = (B, C, (H + 1) // 2, (W + 1) // 2)
    if coarse.shape != expected or alpha.shape != (B, 1, *expected[2:]):
        raise ValueError(
            f"expected coarse {expected} and alpha {(B, 1, *expected[2:])} for fine {tuple(fine.shape)}, "
            f"got {tuple(coarse.shape)} and {tuple(alpha.shape)}"
        )
    if run := fused("compose", fine, coarse, alpha):
        return run(fine, coarse, alpha, pool)
    return fine + upsample(alpha * (coarse - downsample(fine, pool)), tuple(fine.shape[2:]))


def blend(
    spatial: Tensor,  # [B, C, H, W] the filtered current frame
    temporal: Tensor,  # [B, C, H, W] the filtered, reprojected previous output
    alpha: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """`out = α · spatial + (1 - α) · temporal` (the paper's eq. 1 with α learned per pixel)."""
    return torch.lerp(temporal, spatial, alpha)
