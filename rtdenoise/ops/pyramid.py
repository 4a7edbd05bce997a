"""Between the scales, and between space and time: D, U, eq. 4, picking from the coarser scale, and the
final blend."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from .apply_kernel import apply_kernel
from .layout import cells
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


def pick(
    fine: Tensor,  # [B, C, H, W]
    coarse: Tensor,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    logits: Tensor,  # [B, K², H, W], K odd, or by cells: [B, 2, 2, K², ⌈H/2⌉, ⌈W/2⌉] (`apply_kernel`)
    share: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """Let every fine pixel pick from the K×K coarse ones around its own, as far as its share says:

        w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the coarse image
        p[b,c,y,x]   = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · coarse[b, c, ⌊y/2⌋+dy-r, ⌊x/2⌋+dx-r],    r = ⌊K/2⌋
        out[b,c,y,x] = (1 - share) · fine + share · p

    Joint upsampling (Kopf et al. 2007) whose weights are predicted. U of eq. 4 mixes the cells around a pixel whatever
    is in them; here a pixel beside an edge takes those that lie on its side, and has light that was averaged over many
    pixels without any from the other side.

    Raises ValueError where the shapes do not fit.
    """
    B, C, H, W = fine.shape
    half = (H + 1) // 2, (W + 1) // 2
    K = math.isqrt(logits.shape[-3]) if logits.ndim in (4, 6) else 0
    shapes = (B, K**2, H, W), (B, 2, 2, K**2, *half)
    if coarse.shape != (B, C, *half) or share.shape != (B, 1, H, W) or K % 2 == 0 or logits.shape not in shapes:
        raise ValueError(
            f"expected coarse {(B, C, *half)}, share {(B, 1, H, W)} and logits [{B}, K², {H}, {W}] with K odd, or by "
            f"cells, for fine {tuple(fine.shape)}, got {tuple(coarse.shape)}, {tuple(share.shape)} and "
            f"{tuple(logits.shape)}"
        )
    if run := fused("pick", fine, coarse, share, logits):
        return run(fine, coarse, share, logits)
    logits = logits if logits.ndim == 6 else cells(logits)
    each = apply_kernel(coarse.repeat_interleave(4, 0), logits.flatten(0, 2))  # the four pixels of a cell as a batch
    picked = F.pixel_shuffle(each.unflatten(0, (B, 4)).transpose(1, 2).flatten(1, 2), 2)[:, :, :H, :W]
    return torch.lerp(fine, picked, share)


def blend(
    spatial: Tensor,  # [B, C, H, W] the filtered current frame
    temporal: Tensor,  # [B, C, H, W] the filtered, reprojected previous output
    alpha: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """`out = α · spatial + (1 - α) · temporal` (the paper's eq. 1 with α learned per pixel)."""
    return torch.lerp(temporal, spatial, alpha)
