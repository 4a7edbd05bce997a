"""`evened` and `held_and_tells`: the greatest value of each cell, then each pixel with those of its cell and the eight
around it."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import AROUND_CELL, MIX_SEEN_ONCE
from .common import BLOCK, grid, lerp, place, row_of

CELLS = 8  # of a program that looks for the greatest value of each


@triton.jit
def _greatest(x, most, H, W, CELL: tl.constexpr, CELLS: tl.constexpr):
    """The greatest value of each cell: [B, 1, H, W], of floats or bytes, to [B, 1, ⌈H/CELL⌉, ⌈W/CELL⌉]."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i = row_of(h)
    row = i * CELL + tl.arange(0, CELL)[:, None]
    column = tl.program_id(0) * CELLS * CELL + tl.arange(0, CELLS * CELL)[None, :]
    inside = (row < H) & (column < W)
    value = tl.load(x + b * H * W + row * W + column, mask=inside, other=0).to(tl.float32)
    value = tl.max(tl.where(inside, value, -float("inf")), axis=0)
    j = tl.program_id(0) * CELLS + tl.arange(0, CELLS)
    tl.store(most + (b * h + i) * w + j, tl.max(tl.reshape(value, [CELLS, CELL]), axis=1), mask=j < w)


@triton.jit
def _around(most, b, y, x, exists, H, W, CELL: tl.constexpr):
    """The greatest value of the cell of each pixel and the eight around it."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    found = tl.full(x.shape, -float("inf"), tl.float32)
    for k in tl.static_range(9):
        i, j = y // CELL + k // 3 - 1, x // CELL + k % 3 - 1
        inside = exists & (i >= 0) & (i < h) & (j >= 0) & (j < w)
        found = tl.maximum(found, tl.load(most + (b * h + i) * w + j, mask=inside, other=-float("inf")))
    return found


@triton.jit
def _evened(light, count, image, trust, most, out, H, W, share, C: tl.constexpr, CELL: tl.constexpr,
            BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane, around = tl.cast(H, tl.int64) * W, _around(most, b, y, x, exists, H, W, CELL)
    at = y * W + x
    once = 1 - _in_unit(tl.load(count + b * plane + at, mask=exists, other=0.0) - 1)
    trusted = tl.load(trust + b * plane + at, mask=exists, other=0.0)
    weight = 1 - share * trusted * once * _in_unit(around - 1)
    for c in tl.static_range(C):
        here = (b * C + c) * plane + at
        averaged = tl.load(light + here, mask=exists, other=0.0)
        denoised = tl.load(image + here, mask=exists, other=0.0)
        tl.store(out + here, lerp(denoised, averaged, weight), mask=exists)


@triton.jit
def _in_unit(x):
    return tl.minimum(tl.maximum(x, 0.0), 1.0)


@triton.jit
def _tells(held, most, numbers, tells, H, W, CELL: tl.constexpr, BLOCK: tl.constexpr):
    b, y, x, exists = place(H, W, BLOCK)
    around, here = _around(most, b, y, x, exists, H, W, CELL), b * H * W + y * W + x
    own = tl.load(held + here, mask=exists, other=0).to(tl.float32)
    tl.store(numbers + here, own, mask=exists)
    tl.store(tells + here, own + (1 - own) * (1 - around), mask=exists)


def evened(light: Tensor, count: Tensor, image: Tensor, trust: Tensor) -> Tensor:
    light, count, image, trust = (t.contiguous() for t in (light, count, image, trust))
    B, C, H, W = light.shape
    out, most = torch.empty_like(light), _greatest_of_cells(count)
    constants = {"C": C, "CELL": AROUND_CELL, "BLOCK": BLOCK}
    _evened[grid(B, H, W)](light, count, image, trust, most, out, H, W, 1 - MIX_SEEN_ONCE, **constants)
    return out


def held_and_tells(held: Tensor) -> tuple[Tensor, Tensor]:
    held = held.contiguous()
    held = held.view(torch.uint8) if held.dtype is torch.bool else held
    B, _, H, W = held.shape
    numbers, tells = (torch.empty_like(held, dtype=torch.float32) for _ in range(2))
    _tells[grid(B, H, W)](held, _greatest_of_cells(held), numbers, tells, H, W, CELL=AROUND_CELL, BLOCK=BLOCK)
    return numbers, tells


def _greatest_of_cells(x: Tensor) -> Tensor:
    B, _, H, W = x.shape
    h, w = triton.cdiv(H, AROUND_CELL), triton.cdiv(W, AROUND_CELL)
    most = torch.empty(B, 1, h, w, dtype=torch.float32, device=x.device)
    _greatest[triton.cdiv(w, CELLS), B * h](x, most, H, W, CELL=AROUND_CELL, CELLS=CELLS)
    return most
