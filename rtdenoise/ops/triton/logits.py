"""The logits of a pixel's kernel, by the strides of `ops.logits.strides`."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def offset(y, x, cell_row, row, cell, step):
    """Offset of the logits of pixel (y, x)."""
    y, x = y.to(tl.int64), x.to(tl.int64)
    return y // 2 * cell_row + y % 2 * row + x // 2 * cell + x % 2 * step


@triton.jit
def greatest(here, y, x, exists, H, W, stride, K: tl.constexpr):
    """The greatest logit of the taps on the screen; 0 for pixels that do not exist."""
    most = tl.full(x.shape, -float("inf"), tl.float32)
    for k in tl.static_range(K * K):
        i, j = y + k // K - K // 2, x + k % K - K // 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        most = tl.maximum(most, tl.load(here + k * stride, mask=inside, other=-float("inf")).to(tl.float32))
    return tl.where(exists, most, 0.0)
