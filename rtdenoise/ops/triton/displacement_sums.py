"""`displacement_sums`, a cell a program, and all rounds of `displacement`: two launches each."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, SHIFT_AROUND, SHIFT_ROUNDS, SHIFT_STRIDE
from .cells import between
from .common import place, row_of
from .targets import clamped_target, on_screen

CELLS = 32  # cells of a program that solves for their shifts: there are few


@triton.jit
def _sums(now, before, motion, shift, here, depth, was, sums, H, W, tolerance, SHIFTED: tl.constexpr,
          CELL: tl.constexpr, STRIDE: tl.constexpr, SIDE: tl.constexpr):  # fmt: skip
    """The sums of one cell, of which SIDE × SIDE pixels or fewer are looked at."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i = row_of(h)
    j = tl.program_id(0)
    plane, cells = tl.cast(H, tl.int64) * W, tl.cast(h, tl.int64) * w
    n = tl.arange(0, SIDE * SIDE)
    y, x = (tl.cdiv(i * CELL, STRIDE) + n // SIDE) * STRIDE, (tl.cdiv(j * CELL, STRIDE) + n % SIDE) * STRIDE
    exists = (y < tl.minimum((i + 1) * CELL, H)) & (x < tl.minimum((j + 1) * CELL, W))
    at = y * W + x
    counted = tl.load(here + b * plane + at, mask=exists, other=0.0)
    exists = exists & (counted != 0)  # nothing is read for the others: most pixels of many pictures
    motion += b * 2 * plane
    u, v = tl.load(motion + at, mask=exists, other=0.0), tl.load(motion + plane + at, mask=exists, other=0.0)
    if SHIFTED:
        shift += b * 2 * cells
        u += between(shift, y, x, exists, h, w, CELL)
        v += between(shift + cells, y, x, exists, h, w, CELL)
    seen = on_screen(x + u, y + v, H, W)
    u, v = clamped_target(u, x, W), clamped_target(v, y, H)
    x0, y0 = u.to(tl.int32), v.to(tl.int32)
    f, g = u - x0, v - y0
    x1, y1 = tl.minimum(x0 + 1, W - 1), tl.minimum(y0 + 1, H - 1)

    was += b * plane
    p, q = tl.load(was + y0 * W + x0, mask=exists, other=0.0), tl.load(was + y0 * W + x1, mask=exists, other=0.0)
    r, s = tl.load(was + y1 * W + x0, mask=exists, other=0.0), tl.load(was + y1 * W + x1, mask=exists, other=0.0)
    far = _mixed(_mixed(p, q, f), _mixed(r, s, f), g)
    own = tl.load(depth + b * plane + at, mask=exists, other=0.0)
    same = tl.abs(own - far) <= tolerance * tl.maximum(own, far)
    weight = tl.where(seen & same, counted, 0.0)

    # The four pixels around the target and those beside them: the last column repeats, but counts nothing there.
    before += b * plane
    left, right = tl.maximum(x0 - 1, 0), tl.minimum(x1 + 1, W - 1)
    above, below = tl.maximum(y0 - 1, 0) * W, tl.minimum(y1 + 1, H - 1) * W
    p, q = tl.load(before + y0 * W + x0, mask=exists, other=0.0), tl.load(before + y0 * W + x1, mask=exists, other=0.0)
    r, s = tl.load(before + y1 * W + x0, mask=exists, other=0.0), tl.load(before + y1 * W + x1, mask=exists, other=0.0)
    top = q - tl.load(before + y0 * W + left, mask=exists, other=0.0)
    top = _mixed(top, tl.load(before + y0 * W + right, mask=exists, other=0.0) - p, f)
    bottom = s - tl.load(before + y1 * W + left, mask=exists, other=0.0)
    bottom = _mixed(bottom, tl.load(before + y1 * W + right, mask=exists, other=0.0) - r, f)
    first = r - tl.load(before + above + x0, mask=exists, other=0.0)
    first = _mixed(first, tl.load(before + below + x0, mask=exists, other=0.0) - p, g)
    second = s - tl.load(before + above + x1, mask=exists, other=0.0)
    second = _mixed(second, tl.load(before + below + x1, mask=exists, other=0.0) - q, g)
    across, down = _mixed(top, bottom, g) * 0.5, _mixed(first, second, f) * 0.5
    apart = tl.load(now + b * plane + at, mask=exists, other=0.0) - _mixed(_mixed(p, q, f), _mixed(r, s, f), g)

    sums += b * 7 * cells + i * w + j
    tl.store(sums, tl.sum(weight, axis=0))
    tl.store(sums + cells, tl.sum(weight * across * across, axis=0))
    tl.store(sums + 2 * cells, tl.sum(weight * across * down, axis=0))
    tl.store(sums + 3 * cells, tl.sum(weight * down * down, axis=0))
    tl.store(sums + 4 * cells, tl.sum(weight * across * apart, axis=0))
    tl.store(sums + 5 * cells, tl.sum(weight * down * apart, axis=0))
    tl.store(sums + 6 * cells, tl.sum(weight * apart * apart, axis=0))


@triton.jit
def _mixed(a, b, weight):
    return a * (1 - weight) + b * weight


@triton.jit
def _solve(sums, shift, first, left, h, w, damping, enough, FIRST: tl.constexpr, LAST: tl.constexpr,
           AROUND: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    """The shift of each cell by the sums around it; `first` keeps Σ w e² of the first round for the last."""
    b, i, j, exists = place(h, w, BLOCK)
    cells, at = tl.cast(h, tl.int64) * w, i * w + j
    sums += b * 7 * cells
    count = tl.zeros([BLOCK], tl.float32)
    xx, xy, yy, x, y, square = count, count, count, count, count, count
    for k in tl.static_range(AROUND * AROUND):
        row, column = i + k // AROUND - AROUND // 2, j + k % AROUND - AROUND // 2
        inside = exists & (row >= 0) & (row < h) & (column >= 0) & (column < w)
        there = sums + row * w + column
        count += tl.load(there, mask=inside, other=0.0)
        xx += tl.load(there + cells, mask=inside, other=0.0)
        xy += tl.load(there + 2 * cells, mask=inside, other=0.0)
        yy += tl.load(there + 3 * cells, mask=inside, other=0.0)
        x += tl.load(there + 4 * cells, mask=inside, other=0.0)
        y += tl.load(there + 5 * cells, mask=inside, other=0.0)
        square += tl.load(there + 6 * cells, mask=inside, other=0.0)
    xx, yy = xx + damping * count + 1e-6, yy + damping * count + 1e-6
    there = tl.where(count > enough, 1.0, 0.0)
    determinant = xx * yy - xy * xy
    across, down = (yy * x - xy * y) / determinant * there, (xx * y - xy * x) / determinant * there
    shift += b * 2 * cells + at
    if FIRST:
        tl.store(shift, across, mask=exists)
        tl.store(shift + cells, down, mask=exists)
    else:
        tl.store(shift, tl.load(shift, mask=exists, other=0.0) + across, mask=exists)
        tl.store(shift + cells, tl.load(shift + cells, mask=exists, other=0.0) + down, mask=exists)
    at += b * cells
    if LAST:
        whole = square if FIRST else tl.load(first + at, mask=exists, other=1.0)
        tl.store(left + at, (square - (across * x + down * y)) / tl.maximum(whole, 1e-30), mask=exists)
    elif FIRST:
        tl.store(first + at, square, mask=exists)


def displacement_sums(
    now: Tensor,
    before: Tensor,
    motion: Tensor,
    shift: Tensor | None,
    here: Tensor,
    depth: Tensor,
    was: Tensor,
    cell: int,
    stride: int,
    tolerance: float,
) -> Tensor:
    """`shift` may be None: none so far."""
    now, before, motion, here, depth, was = (t.contiguous() for t in (now, before, motion, here, depth, was))
    B, _, H, W = now.shape
    h, w, side = triton.cdiv(H, cell), triton.cdiv(W, cell), triton.next_power_of_2(triton.cdiv(cell, stride))
    sums, constants = now.new_empty(B, 7, h, w), {"CELL": cell, "STRIDE": stride, "SIDE": side}
    before_that = motion if shift is None else shift.contiguous()
    _sums[w, B * h](
        now, before, motion, before_that, here, depth, was, sums, H, W, tolerance, SHIFTED=shift is not None,
        **constants, num_warps=min(max(side * side // 32, 1), 4),
    )  # fmt: skip
    return sums


def displacement(
    now: Tensor, before: Tensor, motion: Tensor, *others: Tensor, cell: int, damping: float
) -> tuple[Tensor, Tensor]:
    now, before, motion, *others = (t.contiguous() for t in (now, before, motion, *others))
    B, _, H, W = now.shape
    h, w = triton.cdiv(H, cell), triton.cdiv(W, cell)
    shift, first, left = (now.new_empty(B, count, h, w) for count in (2, 1, 1))
    limits = damping, cell * SHIFT_AROUND / SHIFT_STRIDE**2
    for k in range(SHIFT_ROUNDS):
        found = shift if k else None
        sums = displacement_sums(now, before, motion, found, *others, cell, SHIFT_STRIDE, DEPTH_TOLERANCE)
        ends = {"FIRST": k == 0, "LAST": k == SHIFT_ROUNDS - 1, "AROUND": SHIFT_AROUND, "BLOCK": CELLS}
        _solve[triton.cdiv(w, CELLS), B * h](sums, shift, first, left, h, w, *limits, **ends, num_warps=1)
    return shift, left
