"""Joint upsampling with predicted weights."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from .apply_kernel import MAX_KERNEL, apply_kernel
from .dispatch import Fused, Support, falls_back
from .logits import cells

FUSED = Fused(
    "pick", native=Support(max_channels=8, max_kernel=MAX_KERNEL, halves=("logits",), other=("coarse", "logits"))
)


@falls_back
def pick(
    fine: Tensor,  # [B, C, H, W]
    coarse: Tensor,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    logits: Tensor,  # [B, K², H, W], K odd, or by cells: [B, 2, 2, K², ⌈H/2⌉, ⌈W/2⌉] (`apply_kernel`)
    share: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """Blend every fine pixel with a weighted mean of the K×K coarse pixels around it:

        w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the coarse image
        p[b,c,y,x]   = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · coarse[b, c, ⌊y/2⌋+dy-r, ⌊x/2⌋+dx-r],    r = ⌊K/2⌋
        out[b,c,y,x] = (1 - share) · fine + share · p

    This is joint upsampling (Kopf et al. 2007) with predicted weights. U of eq. 4 mixes the cells around a pixel
    whatever they show; here a pixel beside an edge can take only the cells on its own side, and so receives light that
    was averaged over many pixels but not across the edge.

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
    if run := FUSED(fine=fine, coarse=coarse, share=share, logits=logits):
        return run(fine, coarse, share, logits)
    logits = logits if logits.ndim == 6 else cells(logits)
    each = apply_kernel(coarse.repeat_interleave(4, 0), logits.flatten(0, 2))  # the four pixels of a cell as a batch
    picked = F.pixel_shuffle(each.unflatten(0, (B, 4)).transpose(1, 2).flatten(1, 2), 2)[:, :, :H, :W]
    return torch.lerp(fine, picked, share)
