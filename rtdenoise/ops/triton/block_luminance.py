"""`block_luminance`: a program has some blocks beside each other, ROWS rows of them at a time."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from .common import row_of
from .luminance import luminance

COLUMNS, PIXELS = 128, 1024  # of a program, at least and about


@triton.jit
def _block_luminance(radiance, means, maxima, H, W, SIDE: tl.constexpr, ROWS: tl.constexpr, COUNT: tl.constexpr,
                     WIDE: tl.constexpr):  # fmt: skip
    rows, columns = tl.cdiv(H, SIDE), tl.cdiv(W, SIDE)
    b, row = row_of(rows)
    plane, column = tl.cast(H, tl.int64) * W, tl.program_id(0) * COUNT + tl.arange(0, COUNT)
    across = tl.arange(0, WIDE)[None, None, :]
    x = column[None, :, None] * SIDE + across
    total = tl.zeros([ROWS, COUNT, WIDE], tl.float32)
    most = total - float("inf")
    for top in range(0, SIDE, ROWS):
        down = top + tl.arange(0, ROWS)[:, None, None]
        y = row * SIDE + down
        inside = (down < SIDE) & (y < H) & (across < SIDE) & (x < W)
        light = luminance(radiance + 3 * b * plane + y * W + x, plane, inside)
        total += light
        most = tl.maximum(most, tl.where(inside, light, -float("inf")))
    count = tl.minimum(H - row * SIDE, SIDE) * tl.maximum(tl.minimum(W - column * SIDE, SIDE), 1)
    at = (b * rows + row) * columns + column
    tl.store(means + at, tl.sum(tl.sum(total, axis=2), axis=0) / count, mask=column < columns)
    tl.store(maxima + at, tl.max(tl.max(most, axis=2), axis=0), mask=column < columns)


def block_luminance(radiance: Tensor, block: int) -> tuple[Tensor, Tensor]:
    radiance = radiance.contiguous()
    B, _, H, W = radiance.shape
    rows, columns, wide = triton.cdiv(H, block), triton.cdiv(W, block), triton.next_power_of_2(block)
    count = max(1, COLUMNS // wide)
    at_once = min(wide, max(1, PIXELS // (count * wide)))
    means, maxima = radiance.new_empty(2, B, rows * columns)
    _block_luminance[triton.cdiv(columns, count), B * rows](
        radiance, means, maxima, H, W, SIDE=block, ROWS=at_once, COUNT=count, WIDE=wide, enable_fp_fusion=False
    )
    return means, maxima
