"""`expand_within`: the bounds of each cell, then each pixel within those of its cell and the eight around it."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import AROUND_CELL
from .common import BLOCK, grid, place, row_of
from .curve import expanded


@triton.jit
def _bounds(first, other, least, most, H, W, CELL: tl.constexpr):
    """The least and the greatest value of both pictures in a cell, which a program reads."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    n, i = row_of(h)  # n: plane
    y = i * CELL + tl.arange(0, CELL)[:, None]
    x = tl.program_id(0) * CELL + tl.arange(0, CELL)[None, :]
    inside, at = (y < H) & (x < W), n * H * W + y * W + x
    a, b = tl.load(first + at, mask=inside, other=0.0), tl.load(other + at, mask=inside, other=0.0)
    low = tl.where(inside, tl.minimum(a, b), float("inf"))
    high = tl.where(inside, tl.maximum(a, b), -float("inf"))
    cell = (n * h + i) * w + tl.program_id(0)
    tl.store(least + cell, tl.min(tl.min(low, axis=1), axis=0))
    tl.store(most + cell, tl.max(tl.max(high, axis=1), axis=0))


@triton.jit
def _within(compressed, least, most, out, H, W, CELL: tl.constexpr, BLOCK: tl.constexpr):
    n, y, x, exists = place(H, W, BLOCK)  # n: plane
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    least += n * h * w
    most += n * h * w
    low = tl.full([BLOCK], float("inf"), tl.float32)
    high = -low
    for k in tl.static_range(9):
        i, j = y // CELL + k // 3 - 1, x // CELL + k % 3 - 1
        inside = exists & (i >= 0) & (i < h) & (j >= 0) & (j < w)
        low = tl.minimum(low, tl.load(least + i * w + j, mask=inside, other=float("inf")))
        high = tl.maximum(high, tl.load(most + i * w + j, mask=inside, other=-float("inf")))
    at = n * H * W + y * W + x
    value = expanded(tl.load(compressed + at, mask=exists, other=0.0))
    tl.store(out + at, tl.minimum(tl.maximum(value, low), high), mask=exists)


def expand_within(compressed: Tensor, first: Tensor, other: Tensor) -> Tensor:
    compressed, first, other = compressed.contiguous(), first.contiguous(), other.contiguous()
    B, C, H, W = compressed.shape
    h, w = triton.cdiv(H, AROUND_CELL), triton.cdiv(W, AROUND_CELL)
    least, most = first.new_empty(B, C, h, w), first.new_empty(B, C, h, w)
    out = torch.empty_like(compressed)
    _bounds[w, B * C * h](first, other, least, most, H, W, CELL=AROUND_CELL)
    _within[grid(B * C, H, W)](compressed, least, most, out, H, W, CELL=AROUND_CELL, BLOCK=BLOCK)
    return out
