"""`soften`: every fine pixel computes the four coarse pixels around it."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place, within
from .pool import pooled


@triton.jit
def _low(fine, y, x, exists, H, W):
    """D fine at the coarse pixel (y, x), clamped to the image."""
    h, w = (H + 1) // 2, (W + 1) // 2
    y, x = within(y, h), within(x, w)
    return pooled(fine, y, x, exists, H, W, False)


@triton.jit
def _soften(composed, fine, share, out, H, W, C: tl.constexpr, BLOCK: tl.constexpr):
    n, y, x, exists = place(H, W, BLOCK)  # n: plane
    fine += n * H * W
    v, u = y // 2, x // 2
    far_v, far_u = v + 2 * (y % 2) - 1, u + 2 * (x % 2) - 1
    near = 0.75 * _low(fine, v, u, exists, H, W) + 0.25 * _low(fine, v, far_u, exists, H, W)
    far = 0.75 * _low(fine, far_v, u, exists, H, W) + 0.25 * _low(fine, far_v, far_u, exists, H, W)
    pixel = y * W + x
    detail = tl.load(fine + pixel, mask=exists, other=0.0) - 0.75 * near - 0.25 * far
    kept = tl.load(share + n // C * H * W + pixel, mask=exists, other=0.0)
    value = tl.load(composed + n * H * W + pixel, mask=exists, other=0.0) - (1 - kept) * detail
    tl.store(out + n * H * W + pixel, value, mask=exists)


def soften(composed: Tensor, fine: Tensor, share: Tensor) -> Tensor:
    composed, fine, share = composed.contiguous(), fine.contiguous(), share.contiguous()
    B, C, H, W = fine.shape
    out = torch.empty_like(fine)
    _soften[grid(B * C, H, W)](composed, fine, share, out, H, W, C=C, BLOCK=BLOCK)
    return out
