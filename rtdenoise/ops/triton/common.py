"""The grid that all kernels share: the pixels of a program, and the number of programs.

Triton makes an argument of 1 a constant, which has no methods: kernels widen sizes by `tl.cast`, not by `.to`.
"""

from __future__ import annotations

import triton
import triton.language as tl

BLOCK = 128


@triton.jit
def place(H, W, BLOCK: tl.constexpr):
    """Image, rows and columns of the pixels of a program, and which of them exist."""
    row = tl.program_id(1)
    x = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    return (row // H).to(tl.int64), row % H + tl.zeros([BLOCK], tl.int32), x, x < W


def grid(images: int, H: int, W: int) -> tuple[int, int]:
    """The number of programs for `images` images of H × W."""
    return triton.cdiv(W, BLOCK), images * H


def constants(C: int) -> dict[str, int]:
    """The named constants of a kernel that computes C channels at once."""
    return {"C": C, "CP": triton.next_power_of_2(C), "BLOCK": BLOCK}
