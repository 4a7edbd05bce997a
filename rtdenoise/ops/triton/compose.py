"""`compose`: every fine pixel computes the four coarse differences around it."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place, within
from .pool import pooled


@triton.jit
def _change(fine, coarse, alpha, y, x, exists, H, W, MAXIMUM: tl.constexpr):
    """alpha · (coarse - D fine) at the coarse pixel (y, x), clamped to the image."""
    h, w = (H + 1) // 2, (W + 1) // 2
    y, x = within(y, h), within(x, w)
    a = tl.load(alpha + y * w + x, mask=exists, other=0.0)
    return a * (tl.load(coarse + y * w + x, mask=exists, other=0.0) - pooled(fine, y, x, exists, H, W, MAXIMUM))


@triton.jit
def _compose(fine, coarse, alpha, out, H, W, C: tl.constexpr, MAXIMUM: tl.constexpr, BLOCK: tl.constexpr):
    n, y, x, exists = place(H, W, BLOCK)  # n: plane
    size = tl.cast((H + 1) // 2, tl.int64) * ((W + 1) // 2)
    fine += n * H * W
    coarse += n * size
    alpha += n // C * size
    v, u = y // 2, x // 2
    far_v, far_u = v + 2 * (y % 2) - 1, u + 2 * (x % 2) - 1
    near = 0.75 * _change(fine, coarse, alpha, v, u, exists, H, W, MAXIMUM)
    near += 0.25 * _change(fine, coarse, alpha, v, far_u, exists, H, W, MAXIMUM)
    far = 0.75 * _change(fine, coarse, alpha, far_v, u, exists, H, W, MAXIMUM)
    far += 0.25 * _change(fine, coarse, alpha, far_v, far_u, exists, H, W, MAXIMUM)
    value = tl.load(fine + y * W + x, mask=exists, other=0.0) + 0.75 * near + 0.25 * far
    tl.store(out + n * H * W + y * W + x, value, mask=exists)


def compose(fine: Tensor, coarse: Tensor, alpha: Tensor, pool: str) -> Tensor:
    fine, coarse, alpha = fine.contiguous(), coarse.contiguous(), alpha.contiguous()
    B, C, H, W = fine.shape
    out = torch.empty_like(fine)
    _compose[grid(B * C, H, W)](fine, coarse, alpha, out, H, W, C=C, MAXIMUM=pool == "max", BLOCK=BLOCK)
    return out
