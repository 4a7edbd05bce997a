"""What all kernels share: which pixels a program computes, and how many programs there are."""

from __future__ import annotations

import triton
import triton.language as tl

BLOCK = 128


@triton.jit
def place(H, W, BLOCK: tl.constexpr):
    """Image, row and columns of a program, and which of the columns exist."""
    row = tl.program_id(1)
    x = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    return (row // H).to(tl.int64), row % H + tl.zeros([BLOCK], tl.int32), x, x < W


def grid(images: int, H: int, W: int) -> tuple[int, int]:
    """The programs for so many images of H × W."""
    return triton.cdiv(W, BLOCK), images * H


def constants(C: int) -> dict[str, int]:
    """Of a kernel for C channels at once."""
    return {"C": C, "CP": triton.next_power_of_2(C), "BLOCK": BLOCK}
