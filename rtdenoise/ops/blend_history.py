"""The temporal kernel and the blend, in one pass."""

from __future__ import annotations

import torch
from torch import Tensor

from .apply_kernel import MAX_KERNEL, apply_kernel, check
from .blend import blend
from .dispatch import Fused, Support, falls_back

SUPPORT = Support(
    max_channels=8, max_kernel=MAX_KERNEL, halves=("logits",), other=("logits",),
    channels={"spatial": (0,), "alpha": (1,)},
)  # fmt: skip
FUSED = Fused("blend_history", native=SUPPORT, triton=SUPPORT)


@falls_back
def blend_history(
    spatial: Tensor,  # [B, C, H, W] the filtered current frame
    past: Tensor,  # [B, C, H, W] the reprojected previous output
    seen: Tensor,  # [B, 1, H, W] bool: where `past` is valid; `spatial` takes its place elsewhere
    logits: Tensor,  # of the temporal kernel, as `apply_kernel` takes them
    alpha: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """`blend(spatial, apply_kernel(where(seen, past, spatial), logits), alpha)`: the paper's temporal kernel and its
    eq. 1. Raises ValueError where the logits do not fit."""
    check(past, logits)
    fits = seen.dtype is torch.bool and seen.shape == alpha.shape
    if fits and (run := FUSED(past=past, spatial=spatial, alpha=alpha, logits=logits)):
        return run(spatial, past, seen, logits, alpha)
    return blend(spatial, apply_kernel(torch.where(seen, past, spatial), logits), alpha)
