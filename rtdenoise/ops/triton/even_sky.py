"""`even_sky`, in two passes: the extremes of the open pixels of every block, then the pixels. Their tiles are rows of
blocks, [SIDE, COUNT, SIDE], which are COUNT · SIDE neighbouring pixels along x."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import SKY_BLOCK, SKY_TOLERANCE
from .common import row_of

COUNT = 8  # blocks of a program


@triton.jit
def _tile(H, SIDE: tl.constexpr, COUNT: tl.constexpr):
    """Image, row and columns of the blocks of a program, rows and columns of their pixels."""
    b, row = row_of(tl.cdiv(H, SIDE))
    column = tl.program_id(0) * COUNT + tl.arange(0, COUNT)
    y = row * SIDE + tl.arange(0, SIDE)[:, None, None]
    x = column[None, :, None] * SIDE + tl.arange(0, SIDE)[None, None, :]
    return b, row, column, y, x


@triton.jit
def _hit(depth, y, x, H, W):
    """Whether something was hit; nothing is outside the image."""
    inside = (y >= 0) & (y < H) & (x >= 0) & (x < W)
    return tl.load(depth + y * W + x, mask=inside, other=0.0) > 0


@triton.jit
def _blocks(radiance, depth, lowest, highest, H, W, SIDE: tl.constexpr, COUNT: tl.constexpr):
    b, row, column, y, x = _tile(H, SIDE, COUNT)
    plane, columns = tl.cast(H, tl.int64) * W, tl.cdiv(W, SIDE)
    size = tl.cast(tl.cdiv(H, SIDE), tl.int64) * columns
    depth += b * plane
    closed = _hit(depth, y, x, H, W)
    for k in tl.static_range(9):
        if k != 4:
            closed = closed | _hit(depth, y + k // 3 - 1, x + k % 3 - 1, H, W)
    opened = (closed == 0) & (y < H) & (x < W)
    for c in tl.static_range(3):
        light = tl.load(radiance + (3 * b + c) * plane + y * W + x, mask=opened, other=0.0)
        low, high = tl.where(opened, light, float("inf")), tl.where(opened, light, -float("inf"))
        at = (3 * b + c) * size + row * columns + column
        tl.store(lowest + at, tl.min(tl.min(low, axis=2), axis=0), mask=column < columns)
        tl.store(highest + at, tl.max(tl.max(high, axis=2), axis=0), mask=column < columns)


@triton.jit
def _even(light, lowest, highest, row, column, rows, columns, tolerance, COUNT: tl.constexpr):
    """Whether light of a pixel is even with the open pixels of its block and the 8 around it."""
    low = tl.full([COUNT], float("inf"), tl.float32)
    high = -low
    for k in tl.static_range(9):
        i, j = row + k // 3 - 1 + tl.zeros([COUNT], tl.int32), column + k % 3 - 1
        inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
        low = tl.minimum(low, tl.load(lowest + i * columns + j, mask=inside, other=float("inf")))
        high = tl.maximum(high, tl.load(highest + i * columns + j, mask=inside, other=-float("inf")))
    low, high, margin = low[None, :, None], high[None, :, None], tolerance * light
    return (high - light <= margin) & (light - low <= margin) & (low <= high)


@triton.jit
def _even_sky(image, radiance, depth, lowest, highest, out, H, W, tolerance, SIDE: tl.constexpr, COUNT: tl.constexpr):
    b, row, column, y, x = _tile(H, SIDE, COUNT)
    plane, rows, columns = tl.cast(H, tl.int64) * W, tl.cdiv(H, SIDE), tl.cdiv(W, SIDE)
    size = tl.cast(rows, tl.int64) * columns
    exists, at = (y < H) & (x < W), 3 * b * plane + y * W + x
    depth += b * plane
    lowest += 3 * b * size
    highest += 3 * b * size
    closed = _hit(depth, y, x, H, W) | _hit(depth, y - 1, x, H, W) | _hit(depth, y + 1, x, H, W)
    closed = closed | _hit(depth, y, x - 1, H, W) | _hit(depth, y, x + 1, H, W)
    red = tl.load(radiance + at, mask=exists, other=0.0)
    green = tl.load(radiance + at + plane, mask=exists, other=0.0)
    blue = tl.load(radiance + at + 2 * plane, mask=exists, other=0.0)
    even = (closed == 0) & _even(red, lowest, highest, row, column, rows, columns, tolerance, COUNT)
    even = even & _even(green, lowest + size, highest + size, row, column, rows, columns, tolerance, COUNT)
    even = even & _even(blue, lowest + 2 * size, highest + 2 * size, row, column, rows, columns, tolerance, COUNT)
    for c in tl.static_range(3):
        filtered = tl.load(image + at + c * plane, mask=exists, other=0.0)
        tl.store(out + at + c * plane, tl.where(even, (red, green, blue)[c], filtered), mask=exists)


def even_sky(image: Tensor, radiance: Tensor, depth: Tensor) -> Tensor:
    image, radiance, depth = image.contiguous(), radiance.contiguous(), depth.contiguous()
    B, _, H, W = image.shape
    rows, columns, out = triton.cdiv(H, SKY_BLOCK), triton.cdiv(W, SKY_BLOCK), torch.empty_like(image)
    lowest, highest = image.new_empty(2, B, 3, rows, columns)
    grid, constants = (triton.cdiv(columns, COUNT), B * rows), {"SIDE": SKY_BLOCK, "COUNT": COUNT}
    _blocks[grid](radiance, depth, lowest, highest, H, W, **constants)
    _even_sky[grid](image, radiance, depth, lowest, highest, out, H, W, SKY_TOLERANCE, **constants)
    return out
