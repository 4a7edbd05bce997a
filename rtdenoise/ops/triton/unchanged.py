"""How far light has stayed as it is, for `recall`, from sums over cells: `ops.recall.unchanged`."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import (
    RECALL_ALIKE,
    RECALL_CHANGED,
    RECALL_JOINED,
    RECALL_WHITE,
    RECALL_WIDE_ALIKE,
    RECALL_WIDE_CHANGED,
)
from .common import BLOCK, grid, place


@triton.jit
def _around(cells, top, left, h, w, exists):
    """The sum of 6 × 6 cells, and those of the 3 × 3 around each of the four in their middle."""
    wide = tl.zeros(left.shape, tl.float32)
    a, b, c, d = wide, wide, wide, wide
    for k in tl.static_range(36):
        y, x = top + k // 6, left + k % 6
        inside = exists & (y >= 0) & (y < h) & (x >= 0) & (x < w)
        term = tl.load(cells + y * w + x, mask=inside, other=0.0)
        wide += term
        if (k // 6 >= 1) and (k // 6 <= 3) and (k % 6 >= 1) and (k % 6 <= 3):
            a += term
        if (k // 6 >= 1) and (k // 6 <= 3) and (k % 6 >= 2) and (k % 6 <= 4):
            b += term
        if (k // 6 >= 2) and (k // 6 <= 4) and (k % 6 >= 1) and (k % 6 <= 3):
            c += term
        if (k // 6 >= 2) and (k // 6 <= 4) and (k % 6 >= 2) and (k % 6 <= 4):
            d += term
    return wide, a, b, c, d


@triton.jit
def _unchanged(r, g, b, square, whole, none):
    q = (r * r + g * g + b * b) / tl.maximum(square, 1e-30)
    return tl.minimum(tl.maximum((none - q) / (none - whole), 0.0), 1.0)


@triton.jit
def _white(products, square, white, joined):
    r = products / tl.maximum(square, 1e-30)
    return tl.minimum(tl.maximum((joined - r) / (joined - white), 0.0), 1.0)


@triton.jit
def _stays(cells, stays, H, W, B, alike, changed, wide_alike, wide_changed, white, joined, SUMS: tl.constexpr,
           BLOCK: tl.constexpr):  # fmt: skip
    """How far light has stayed as it is in each of H × W cells, one kept frame a plane of programs. The four cells of a
    wide one are computed together: they share what is read. With 5 SUMS products of neighbours tell, too."""
    b, i, j, exists = place(tl.cdiv(H, 2), tl.cdiv(W, 2), BLOCK)
    size = tl.cast(H, tl.int64) * W
    n = tl.cast(tl.program_id(2), tl.int64) * B + b
    cells += n * SUMS * size
    y, x = 2 * i, 2 * j
    r, r0, r1, r2, r3 = _around(cells, y - 2, x - 2, H, W, exists)
    g, g0, g1, g2, g3 = _around(cells + size, y - 2, x - 2, H, W, exists)
    a, a0, a1, a2, a3 = _around(cells + 2 * size, y - 2, x - 2, H, W, exists)
    s, s0, s1, s2, s3 = _around(cells + 3 * size, y - 2, x - 2, H, W, exists)
    wide = _unchanged(r, g, a, s, wide_alike, wide_changed)
    stays += n * size + y * W + x
    right, below = exists & (x + 1 < W), exists & (y + 1 < H)
    w0 = wide * _unchanged(r0, g0, a0, s0, alike, changed)
    w1 = wide * _unchanged(r1, g1, a1, s1, alike, changed)
    w2 = wide * _unchanged(r2, g2, a2, s2, alike, changed)
    w3 = wide * _unchanged(r3, g3, a3, s3, alike, changed)
    if SUMS == 5:
        _, u0, u1, u2, u3 = _around(cells + 4 * size, y - 2, x - 2, H, W, exists)
        w0 *= _white(u0, s0, white, joined)
        w1 *= _white(u1, s1, white, joined)
        w2 *= _white(u2, s2, white, joined)
        w3 *= _white(u3, s3, white, joined)
    tl.store(stays, w0, mask=exists)
    tl.store(stays + 1, w1, mask=right)
    tl.store(stays + W, w2, mask=below)
    tl.store(stays + W + 1, w3, mask=right & below)


def unchanged(cells: Tensor, patience: float = 1.0) -> Tensor:
    """`[K, B, 4 or 5, h, w]` sums of differences, of their squares, and of products of neighbours, to `[K, B, h, w]` in
    [0, 1]. `patience`: as that of `ops.recall.unchanged`."""
    K, B, sums, h, w = cells.shape
    stays = cells.new_empty(K, B, h, w)
    bounds = RECALL_ALIKE, RECALL_CHANGED, RECALL_WIDE_ALIKE, RECALL_WIDE_CHANGED
    tests = [patience * bound for bound in bounds]
    tests += RECALL_WHITE, RECALL_JOINED
    _stays[*grid(B, triton.cdiv(h, 2), triton.cdiv(w, 2)), K](cells, stays, h, w, B, *tests, SUMS=sums, BLOCK=BLOCK)
    return stays
