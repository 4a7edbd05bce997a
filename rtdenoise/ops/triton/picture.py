"""`shift.picture.find` and `moved`."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import (
    SHIFT_APART,
    SHIFT_CELL,
    SHIFT_DAMPING,
    SHIFT_GREATEST,
    SHIFT_LEAST,
    SHIFT_LEFT,
    SHIFT_SURE,
)
from .cells import between
from .common import BLOCK, grid, place
from .compressed import compressed
from .displacement_sums import CELLS, displacement
from .light_shift import one_surface
from .targets import clamped_target, on_screen


@triton.jit
def _counts(shift, left, motion, before, found, told, H, W, h, w, most_left, least, most, sure, apart,
            BEFORE: tl.constexpr, CELL: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    """The shifts of cells that count, and those that the next frame is told. `before`: what the last one found."""
    b, i, j, exists = place(h, w, BLOCK)
    cells, plane = tl.cast(h, tl.int64) * w, tl.cast(H, tl.int64) * W
    at = b * 2 * cells + i * w + j
    across, down = tl.load(shift + at, mask=exists, other=0.0), tl.load(shift + at + cells, mask=exists, other=0.0)
    remains = tl.load(left + b * cells + i * w + j, mask=exists, other=0.0)
    length = tl.sqrt(across * across + down * down)
    counts = tl.where((remains < most_left) & (length > least) & (length < most), 1.0, 0.0)
    across, down = across * counts, down * counts
    is_sure = tl.where(remains < sure, 1.0, 0.0)
    told_across, told_down = across * is_sure, down * is_sure
    if BEFORE:
        y, x = i * CELL + CELL // 2, j * CELL + CELL // 2
        middle = exists & (y < H) & (x < W)  # a cell that is cut off before its middle is taken not to move
        motion += b * 2 * plane + y * W + x
        u = clamped_target(tl.load(motion, mask=middle, other=0.0) / CELL, j, w)
        v = clamped_target(tl.load(motion + plane, mask=middle, other=0.0) / CELL, i, h)
        there = before + b * 2 * cells + (v + 0.5).to(tl.int32) * w + (u + 0.5).to(tl.int32)
        was_across = tl.load(there, mask=exists, other=0.0)
        was_down = tl.load(there + cells, mask=exists, other=0.0)
        p, q = across - was_across, down - was_down
        agrees = tl.sqrt(p * p + q * q) <= apart * length
        told_across = tl.where(agrees, (across + was_across) / 2, told_across)
        told_down = tl.where(agrees, (down + was_down) / 2, told_down)
    tl.store(found + at, across, mask=exists)
    tl.store(found + at + cells, down, mask=exists)
    tl.store(told + at, told_across, mask=exists)
    tl.store(told + at + cells, told_down, mask=exists)


@triton.jit
def _moved(shift, motion, surfaces, out, H, W, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """The shift of the pixel that motion leads to, if its cell has one, on the screen and away from edges."""
    b, y, x, exists = place(H, W, BLOCK)
    plane, h, w = tl.cast(H, tl.int64) * W, tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    at = y * W + x
    u = tl.load(motion + b * 2 * plane + at, mask=exists, other=0.0)
    v = tl.load(motion + (b * 2 + 1) * plane + at, mask=exists, other=0.0)
    one = tl.load(surfaces + b * plane + at, mask=exists, other=0.0) > 0
    x_there, y_there = (clamped_target(u, x, W) + 0.5).to(tl.int32), (clamped_target(v, y, H) + 0.5).to(tl.int32)
    there = exists & one & on_screen(x + u, y + v, H, W)
    cells = shift + b * 2 * h * w
    its = cells + y_there // CELL * w + x_there // CELL
    there = there & ((tl.load(its, mask=there, other=0.0) != 0) | (tl.load(its + h * w, mask=there, other=0.0) != 0))
    out += b * 2 * plane + at
    tl.store(out, between(cells, y_there, x_there, there, h, w, CELL), mask=exists)
    tl.store(out + plane, between(cells + h * w, y_there, x_there, there, h, w, CELL), mask=exists)


def find(
    picture: Tensor,
    motion: Tensor,
    depth: Tensor,
    radiance_before: Tensor,
    depth_before: Tensor,
    found_before: Tensor | None,
) -> tuple[Tensor, Tensor]:
    motion = motion.contiguous()
    shift, left = displacement(
        *compressed(picture, radiance_before, blurred=False), motion, one_surface(depth), depth, depth_before,
        cell=SHIFT_CELL, damping=SHIFT_DAMPING,
    )  # fmt: skip
    (B, _, H, W), (h, w) = depth.shape, shift.shape[2:]
    found, told = shift.new_empty(2, B, 2, h, w).unbind()
    before = shift if found_before is None else found_before.contiguous()
    limits = SHIFT_LEFT, SHIFT_LEAST, SHIFT_GREATEST, SHIFT_SURE, SHIFT_APART
    _counts[triton.cdiv(w, CELLS), B * h](
        shift, left, motion, before, found, told, H, W, h, w, *limits, BEFORE=found_before is not None, CELL=SHIFT_CELL,
        BLOCK=CELLS, num_warps=1,
    )  # fmt: skip
    return found, told


def moved(shift: Tensor, motion: Tensor, depth: Tensor) -> Tensor:
    shift, motion = shift.contiguous(), motion.contiguous()
    B, _, H, W = depth.shape
    out = motion.new_empty(B, 2, H, W)
    _moved[grid(B, H, W)](shift, motion, one_surface(depth), out, H, W, CELL=SHIFT_CELL, BLOCK=BLOCK)
    return out
