"""The grids that kernels share: the pixels of a program, and the number of programs.

Triton makes an argument of 1 a constant, which has no methods: kernels widen sizes by `tl.cast`, not by `.to`.
"""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

BLOCK = 128
FLAT = 512  # pixels of a program that takes them across the ends of rows


@triton.jit
def row_of(H):
    """Image and row, of H, of a program."""
    row = tl.program_id(1)
    return (row // H).to(tl.int64), row % H


@triton.jit
def place(H, W, BLOCK: tl.constexpr):
    """Image, rows and columns of the pixels of a program, and which of them exist."""
    b, y = row_of(H)
    x = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    return b, y + tl.zeros([BLOCK], tl.int32), x, x < W


@triton.jit
def place_flat(plane, BLOCK: tl.constexpr):
    """Image, the pixels of a program, numbered along rows, and which of them exist."""
    at = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    return tl.program_id(1).to(tl.int64), at, at < plane


@triton.jit
def within(i, n):
    """The nearest of n rows or columns: borders are repeated."""
    return tl.minimum(tl.maximum(i, 0), n - 1)


@triton.jit
def greater(a, b):
    """As torch.maximum, of numbers of any type: NaN if either is. Float32."""
    return tl.maximum(a.to(tl.float32), b.to(tl.float32), propagate_nan=tl.PropagateNan.ALL)


@triton.jit
def lerp(start, end, weight):
    """As torch.lerp: exact at both ends."""
    return tl.where(weight < 0.5, start + weight * (end - start), end - (1 - weight) * (end - start))


def grid(images: int, H: int, W: int) -> tuple[int, int]:
    """The number of programs for `images` images of H × W."""
    return triton.cdiv(W, BLOCK), images * H


def flat_grid(images: int, plane: int, block: int = FLAT) -> tuple[int, int]:
    """That of `place_flat`: programs of `block` pixels for images of `plane` pixels."""
    return triton.cdiv(plane, block), images


def of_images(x: Tensor, B: int) -> Tensor:
    """A value for each image, `[B, 1, 1, 1]` or one for all, as `[B]`."""
    return x.expand(B, 1, 1, 1).reshape(B).contiguous()


def constants(C: int) -> dict[str, int]:
    """The named constants of a kernel that computes C channels at once."""
    return {"C": C, "CP": triton.next_power_of_2(C), "BLOCK": BLOCK}
