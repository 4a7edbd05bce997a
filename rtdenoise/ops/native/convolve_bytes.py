"""`convolve_bytes`: a block of pixels and outputs stays in registers until all of its products are summed."""

from __future__ import annotations

from ctypes import Structure, byref, c_int, c_void_p

import torch
from torch import Tensor

from ..convolve_bytes import MOST
from .compiler import library, pointer

PAIRS, BYTES = 1, 2  # of multiplies_bytes.c


class Source(Structure):
    """A picture that a convolution reads; the C file says more."""

    _fields_ = [("pixels", c_void_p), *((name, c_int) for name in ("height", "width", "channels", "taps", "step"))]


def convolve_bytes(
    x: Tensor, weight: Tensor, factor: Tensor, bias: Tensor, below: Tensor | None, dtype: torch.dtype
) -> Tensor:
    B, C, H, W = x.shape
    _, quads, stored, _ = weight.shape
    O = factor.shape[1]
    weight, factor, bias = weight.contiguous(), factor.contiguous(), bias.contiguous()
    out = torch.empty(B, O, H, W, dtype=dtype, device="cpu", memory_format=torch.channels_last)
    way = "convolve_pairs" if multiplies() == PAIRS else "convolve_bytes"
    run = library(way, HALF=int(dtype == torch.bfloat16), MOST=MOST).convolve_bytes
    for b in range(B):
        beside = Source(x[b].data_ptr(), H, W, C, 3, 1 if below is None else 2)
        coarse = Source() if below is None else Source(below[b].data_ptr(), H // 2, W // 2, below.shape[1], 2, 1)
        if run(byref(coarse), byref(beside), *map(pointer, (weight, factor, bias, out[b])), quads, stored, O, H, W,
               torch.get_num_threads()):  # fmt: skip
            raise MemoryError("no memory for the weights of a convolution")
    return out


def multiplies() -> int:
    """What this CPU has instructions for: products of BYTES, of PAIRS of 16 bits, or neither (0)."""
    return library("multiplies_bytes").multiplies_bytes()
