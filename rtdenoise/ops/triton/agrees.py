"""`agrees`: sums over cells, their factor, then the pixels."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import AGREES_PATIENCE, RECALL_CELL, RECALL_ROUNDING
from .cells import store_block
from .common import BLOCK, grid, place
from .unchanged import unchanged

SUMS = 4  # of the differences of three channels, and of their squares


@triton.jit
def _compare(light, mean, found, cells, H, W, rounding, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """The sums of each cell, [B, SUMS, h, w]."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i, j, exists = place(h, w, BLOCK)
    plane, size = tl.cast(H, tl.int64) * W, tl.cast(h, tl.int64) * w
    r = tl.zeros([BLOCK], tl.float32)
    g, a, square = r, r, r
    for k in range(CELL * CELL):
        y, x = i * CELL + k // CELL, j * CELL + k % CELL
        inside = exists & (y < H) & (x < W)
        at = b * plane + y * W + x
        has = inside & (tl.load(found + at, mask=inside, other=0) != 0)
        at += 2 * b * plane
        now = tl.load(light + at, mask=has, other=0.0)
        d = tl.load(mean + at, mask=has, other=0.0) - now
        r += d
        square += d * d + rounding * now * now
        at += plane
        now = tl.load(light + at, mask=has, other=0.0)
        d = tl.load(mean + at, mask=has, other=0.0) - now
        g += d
        square += d * d + rounding * now * now
        at += plane
        now = tl.load(light + at, mask=has, other=0.0)
        d = tl.load(mean + at, mask=has, other=0.0) - now
        a += d
        square += d * d + rounding * now * now
    cells += b * 4 * size + i * w + j
    for k in tl.static_range(4):
        tl.store(cells + k * size, (r, g, a, square)[k], mask=exists)


@triton.jit
def _spread(factor, out, H, W, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """Give every pixel the factor of its cell."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i, j, exists = place(h, w, BLOCK)
    value = tl.load(factor + b * tl.cast(h, tl.int64) * w + i * w + j, mask=exists, other=0.0)
    store_block(out + b * tl.cast(H, tl.int64) * W, value, i, j, exists, H, W, CELL)


def agrees(light: Tensor, mean: Tensor, found: Tensor) -> Tensor:
    light, mean, found = light.contiguous(), mean.contiguous(), found.contiguous().view(torch.uint8)
    B, _, H, W = light.shape
    h, w = triton.cdiv(H, RECALL_CELL), triton.cdiv(W, RECALL_CELL)
    cells, out = light.new_empty(1, B, SUMS, h, w), light.new_empty(B, 1, H, W)
    sizes = {"CELL": RECALL_CELL, "BLOCK": BLOCK}
    _compare[grid(B, h, w)](light, mean, found, cells, H, W, RECALL_ROUNDING, **sizes)
    _spread[grid(B, h, w)](unchanged(cells, AGREES_PATIENCE), out, H, W, **sizes)
    return out
