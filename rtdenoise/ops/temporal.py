"""The end of a frame: the temporal kernel and the final blend."""

from __future__ import annotations

import torch
from torch import Tensor

from .apply_kernel import apply_kernel
from .path import fused
from .pyramid import blend


def blend_history(
    spatial: Tensor,  # [B, C, H, W] the filtered current frame
    past: Tensor,  # [B, C, H, W] the previous output, reprojected
    seen: Tensor,  # [B, 1, H, W] bool: where there is one; elsewhere `spatial` takes its place
    logits: Tensor,  # of the temporal kernel, as `apply_kernel` takes them
    alpha: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """`blend(spatial, apply_kernel(past, logits), alpha)`: the paper's temporal kernel and its eq. 1."""
    if run := fused("blend_history", past, spatial, alpha, logits):
        return run(spatial, past, seen, logits, alpha)
    return blend(spatial, apply_kernel(torch.where(seen, past, spatial), logits), alpha)
