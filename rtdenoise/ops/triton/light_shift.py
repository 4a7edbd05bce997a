"""`light_shift`, with blocks of pixels in three passes, and `one_surface`. Depths of a block are the greatest and that
of their opposites, as in the plain ops; a greatest value stays the same where blocks at a border repeat."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import (
    DEPTH_TOLERANCE,
    SHIFT_BESIDE,
    SHIFT_BLOCK,
    SHIFT_EVEN,
    SHIFT_GREATEST,
    SHIFT_LEAST,
    SHIFT_LIGHT_CELL,
    SHIFT_LIGHT_DAMPING,
)
from .cells import between, store_block
from .common import BLOCK, greater, grid, place, within
from .compressed import compressed
from .displacement_sums import displacement
from .luminance import luminance


@triton.jit
def _blocks(radiance, depth, blocks, H, W, tolerance, SIDE: tl.constexpr, BLOCK: tl.constexpr):
    """Whether light of a block is even, 1 or 0, its greatest depth, and the greatest of their opposites."""
    h, w = tl.cdiv(H, SIDE), tl.cdiv(W, SIDE)
    b, i, j, exists = place(h, w, BLOCK)
    plane, size = tl.cast(H, tl.int64) * W, tl.cast(h, tl.int64) * w
    radiance += b * 3 * plane
    depth += b * plane
    total = tl.zeros([BLOCK], tl.float32)
    count = total
    greatest = tl.full([BLOCK], -float("inf"), tl.float32)
    farthest, nearest = greatest, greatest
    for k in tl.static_range(SIDE * SIDE):
        y, x = i * SIDE + k // SIDE, j * SIDE + k % SIDE
        inside = exists & (y < H) & (x < W)
        light = luminance(radiance + y * W + x, plane, inside)
        far = tl.load(depth + y * W + x, mask=inside, other=0.0)
        total += light
        count += tl.where(inside, 1.0, 0.0)
        greatest = tl.where(inside, greater(greatest, light), greatest)
        farthest = tl.where(inside, greater(farthest, far), farthest)
        nearest = tl.where(inside, greater(nearest, -far), nearest)
    mean = total / tl.maximum(count, 1.0)
    blocks += b * 3 * size + i * w + j
    tl.store(blocks, tl.where((greatest <= (1 + tolerance) * mean) & (mean > 0), 1.0, 0.0), mask=exists)
    tl.store(blocks + size, farthest, mask=exists)
    tl.store(blocks + 2 * size, nearest, mask=exists)


@triton.jit
def _near(blocks, near, here, H, W, tolerance, SIDE: tl.constexpr, BLOCK: tl.constexpr):
    """The depths of blocks in and beside which light is even on one surface, -∞ of others; and `here`, 1 in those."""
    h, w = tl.cdiv(H, SIDE), tl.cdiv(W, SIDE)
    b, i, j, exists = place(h, w, BLOCK)
    size = tl.cast(h, tl.int64) * w
    blocks += b * 3 * size
    even = tl.zeros([BLOCK], tl.float32)
    farthest = tl.full([BLOCK], -float("inf"), tl.float32)
    nearest = farthest
    for k in tl.static_range(9):
        there = blocks + within(i + k // 3 - 1, h) * w + within(j + k % 3 - 1, w)
        even = tl.maximum(even, tl.load(there, mask=exists, other=0.0))
        farthest = greater(farthest, tl.load(there + size, mask=exists, other=0.0))
        nearest = greater(nearest, tl.load(there + 2 * size, mask=exists, other=0.0))
    its = (even > 0) & (farthest + nearest <= tolerance * farthest)
    at = i * w + j
    near += b * 2 * size + at
    for k in tl.static_range(2):
        own = tl.load(blocks + (k + 1) * size + at, mask=exists, other=0.0)
        tl.store(near + k * size, tl.where(its, own, -float("inf")), mask=exists)
    store_block(here + b * tl.cast(H, tl.int64) * W, tl.where(its, 1.0, 0.0), i, j, exists, H, W, SIDE)


@triton.jit
def _beside(near, beside, h, w, AROUND: tl.constexpr, BLOCK: tl.constexpr):
    """The greatest of each block and those AROUND it."""
    n, i, j, exists = place(h, w, BLOCK)  # n: plane
    near += n * h * w
    greatest = tl.full([BLOCK], -float("inf"), tl.float32)
    for k in range(2 * AROUND + 1):
        row = near + within(i + k - AROUND, h) * w
        for m in tl.static_range(2 * AROUND + 1):
            greatest = greater(greatest, tl.load(row + within(j + m - AROUND, w), mask=exists, other=0.0))
    tl.store(beside + n * h * w + i * w + j, greatest, mask=exists)


@triton.jit
def _shift(cells, beside, depth, out, H, W, least, most, tolerance, CELL: tl.constexpr, SIDE: tl.constexpr,
           BLOCK: tl.constexpr):  # fmt: skip
    """The shift of a pixel: that of the cells, where it is neither short nor long and the surface is one of those."""
    b, y, x, exists = place(H, W, BLOCK)
    plane, h, w = tl.cast(H, tl.int64) * W, tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    cells += b * 2 * h * w
    across, down = between(cells, y, x, exists, h, w, CELL), between(cells + h * w, y, x, exists, h, w, CELL)
    squared = across * across + down * down
    rows, columns = tl.cdiv(H, SIDE), tl.cdiv(W, SIDE)
    block = beside + b * 2 * rows * columns + y // SIDE * columns + x // SIDE
    farthest = tl.load(block, mask=exists, other=0.0)
    nearest = tl.load(block + rows * columns, mask=exists, other=0.0)
    far = tl.load(depth + b * plane + y * W + x, mask=exists, other=0.0)
    its = (far <= (1 + tolerance) * farthest) & (far >= (tolerance - 1) * nearest)
    counts = tl.where(its & (squared > least * least) & (squared < most * most), 1.0, 0.0)
    out += b * 2 * plane + y * W + x
    tl.store(out, across * counts, mask=exists)
    tl.store(out + plane, down * counts, mask=exists)


@triton.jit
def _surfaces(depth, here, H, W, tolerance, SIDE: tl.constexpr, BLOCK: tl.constexpr):
    """1 in blocks in and beside which depth is that of one surface, else 0."""
    h, w = tl.cdiv(H, SIDE), tl.cdiv(W, SIDE)
    b, i, j, exists = place(h, w, BLOCK)
    depth += b * tl.cast(H, tl.int64) * W
    farthest = tl.full([BLOCK], -float("inf"), tl.float32)
    nearest = farthest
    for k in range(3 * SIDE):
        row = depth + within((i - 1) * SIDE + k, H) * W
        for m in tl.static_range(3 * SIDE):
            far = tl.load(row + within((j - 1) * SIDE + m, W), mask=exists, other=0.0)
            farthest, nearest = greater(farthest, far), greater(nearest, -far)
    one = tl.where(farthest + nearest <= tolerance * farthest, 1.0, 0.0)
    store_block(here + b * tl.cast(H, tl.int64) * W, one, i, j, exists, H, W, SIDE)


def light_shift(noisy: Tensor, noisy_before: Tensor, motion: Tensor, depth: Tensor, depth_before: Tensor) -> Tensor:
    noisy, depth = noisy.contiguous(), depth.contiguous()
    B, _, H, W = noisy.shape
    h, w = triton.cdiv(H, SHIFT_BLOCK), triton.cdiv(W, SHIFT_BLOCK)
    blocks, near, beside = (noisy.new_empty(B, count, h, w) for count in (3, 2, 2))
    here, out = depth.new_empty(B, 1, H, W), depth.new_empty(B, 2, H, W)
    side = {"SIDE": SHIFT_BLOCK, "BLOCK": BLOCK}
    _blocks[grid(B, h, w)](noisy, depth, blocks, H, W, SHIFT_EVEN, **side)
    _near[grid(B, h, w)](blocks, near, here, H, W, DEPTH_TOLERANCE, **side)
    _beside[grid(2 * B, h, w)](near, beside, h, w, AROUND=SHIFT_BESIDE, BLOCK=BLOCK)
    shift, _ = displacement(
        *compressed(noisy, noisy_before, blurred=True), motion, here, depth, depth_before,
        cell=SHIFT_LIGHT_CELL, damping=SHIFT_LIGHT_DAMPING,
    )  # fmt: skip
    limits = SHIFT_LEAST, SHIFT_GREATEST, DEPTH_TOLERANCE
    _shift[grid(B, H, W)](shift, beside, depth, out, H, W, *limits, CELL=SHIFT_LIGHT_CELL, **side)
    return out


def one_surface(depth: Tensor) -> Tensor:
    depth = depth.contiguous()
    B, _, H, W = depth.shape
    here = depth.new_empty(B, 1, H, W)
    blocks = grid(B, triton.cdiv(H, SHIFT_BLOCK), triton.cdiv(W, SHIFT_BLOCK))
    _surfaces[blocks](depth, here, H, W, DEPTH_TOLERANCE, SIDE=SHIFT_BLOCK, BLOCK=BLOCK)
    return here
