"""`turned`: sums over cells, then the pixels."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import TURNED_ANGLE, TURNED_CELL, TURNED_NOISE
from .cells import store_block
from .common import BLOCK, grid, place

SUMS = 5  # of the differences of normals, of their squares, and the pixels that have both


@triton.jit
def _unit(normal, plane, inside):
    """Three components of length 1, or 0, and whether there is a normal."""
    x = tl.load(normal, mask=inside, other=0.0)
    y = tl.load(normal + plane, mask=inside, other=0.0)
    z = tl.load(normal + 2 * plane, mask=inside, other=0.0)
    square = x * x + y * y + z * z
    scale = 1 / tl.sqrt(tl.maximum(square, 1e-12))
    return x * scale, y * scale, z * scale, square > 0


@triton.jit
def _turns(normal, before, cells, H, W, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """The sums of each cell, [B, SUMS, h, w]."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i, j, exists = place(h, w, BLOCK)
    plane, size = tl.cast(H, tl.int64) * W, tl.cast(h, tl.int64) * w
    x_sum = tl.zeros([BLOCK], tl.float32)
    y_sum, z_sum, square, count = x_sum, x_sum, x_sum, x_sum
    for k in range(CELL * CELL):
        y, x = i * CELL + k // CELL, j * CELL + k % CELL
        inside = exists & (y < H) & (x < W)
        at = b * 3 * plane + y * W + x
        now_x, now_y, now_z, has = _unit(normal + at, plane, inside)
        then_x, then_y, then_z, had = _unit(before + at, plane, inside)
        both = has & had
        u = tl.where(both, now_x - then_x, 0.0)
        v = tl.where(both, now_y - then_y, 0.0)
        t = tl.where(both, now_z - then_z, 0.0)
        x_sum += u
        y_sum += v
        z_sum += t
        square += u * u + v * v + t * t
        count += tl.where(both, 1.0, 0.0)
    cells += b * 5 * size + i * w + j
    for k in tl.static_range(5):
        tl.store(cells + k * size, (x_sum, y_sum, z_sum, square, count)[k], mask=exists)


@triton.jit
def _sum_around(cells, i, j, h, w, exists):
    """The sum of a cell and the eight around it."""
    total = tl.zeros(j.shape, tl.float32)
    for k in tl.static_range(9):
        y, x = i + k // 3 - 1, j + k % 3 - 1
        inside = exists & (y >= 0) & (y < h) & (x >= 0) & (x < w)
        total += tl.load(cells + y * w + x, mask=inside, other=0.0)
    return total


@triton.jit
def _gives_way(cells, out, H, W, noise, angle, CELL: tl.constexpr, BLOCK: tl.constexpr):
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i, j, exists = place(h, w, BLOCK)
    size = tl.cast(h, tl.int64) * w
    cells += b * 5 * size
    x = _sum_around(cells, i, j, h, w, exists)
    y = _sum_around(cells + size, i, j, h, w, exists)
    z = _sum_around(cells + 2 * size, i, j, h, w, exists)
    square = x * x + y * y + z * z
    noise *= _sum_around(cells + 3 * size, i, j, h, w, exists)
    count = _sum_around(cells + 4 * size, i, j, h, w, exists)
    sure = tl.maximum(1 - noise / tl.maximum(square, 1e-30), 0.0)
    share = 1 - tl.exp(-(sure * tl.sqrt(square) / tl.maximum(count, 1.0)) / angle)
    store_block(out + b * tl.cast(H, tl.int64) * W, share, i, j, exists, H, W, CELL)


def turned(normal: Tensor, before: Tensor) -> Tensor:
    normal, before = normal.contiguous(), before.contiguous()
    B, _, H, W = normal.shape
    h, w = triton.cdiv(H, TURNED_CELL), triton.cdiv(W, TURNED_CELL)
    cells, out = normal.new_empty(B, SUMS, h, w), normal.new_empty(B, 1, H, W)
    sizes = {"CELL": TURNED_CELL, "BLOCK": BLOCK}
    _turns[grid(B, h, w)](normal, before, cells, H, W, **sizes)
    _gives_way[grid(B, h, w)](cells, out, H, W, TURNED_NOISE, TURNED_ANGLE, **sizes)
    return out
