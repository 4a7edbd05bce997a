"""Values of cells between their middles (`shift.displacement.spread`), and blocks of pixels, for shifts."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def middles(x, n, CELL: tl.constexpr):
    """The cells of a row of n whose middles are before and behind pixel x, and the weight of the second."""
    at = tl.maximum((x + 0.5) * (1.0 / CELL) - 0.5, 0.0)
    low = tl.minimum(at.to(tl.int32), n - 1)
    return low, tl.minimum(low + 1, n - 1), at - low


@triton.jit
def between(cells, y, x, exists, h, w, CELL: tl.constexpr):
    """The value at pixel (y, x), linear between the middles of h × w cells."""
    i, below, g = middles(y, h, CELL)
    j, right, f = middles(x, w, CELL)
    p = tl.load(cells + i * w + j, mask=exists, other=0.0)
    q = tl.load(cells + i * w + right, mask=exists, other=0.0)
    r = tl.load(cells + below * w + j, mask=exists, other=0.0)
    s = tl.load(cells + below * w + right, mask=exists, other=0.0)
    return (1 - g) * ((1 - f) * p + f * q) + g * ((1 - f) * r + f * s)


@triton.jit
def store_block(pixels, value, i, j, exists, H, W, SIDE: tl.constexpr):
    """Give every pixel of block (i, j) its value."""
    for k in tl.static_range(SIDE * SIDE):
        y, x = i * SIDE + k // SIDE, j * SIDE + k % SIDE
        tl.store(pixels + y * W + x, value, mask=exists & (y < H) & (x < W))
