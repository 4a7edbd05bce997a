"""`convolve`: mixtures of inputs and a block of sums stay in the caches until all of their products are summed."""

from __future__ import annotations

from ctypes import Structure, byref, c_int, c_void_p

import torch
from torch import Tensor

from ..convolve import MOST
from .compiler import library, pointer


class _Source(Structure):
    """A picture that a convolution reads; the C file says more."""

    _fields_ = [("pixels", c_void_p), *((name, c_int) for name in ("height", "width", "channels", "size"))]


def convolve(x: Tensor, weight: Tensor, bias: Tensor, of_mixtures: Tensor, below: Tensor | None) -> Tensor:
    B, C, H, W = x.shape
    O, bias = len(weight), bias.contiguous()
    out = torch.empty(B, O, H, W, dtype=x.dtype, device="cpu", memory_format=torch.channels_last)
    run = library("convolve", MOST=MOST).convolve
    for b in range(B):
        beside = _Source(x[b].data_ptr(), H, W, C, 4)
        coarse = _Source() if below is None else _Source(below[b].data_ptr(), H // 2, W // 2, below.shape[1], 3)
        run(byref(coarse), byref(beside), *map(pointer, (of_mixtures, bias, out[b])), of_mixtures.shape[1], O, H, W,
            torch.get_num_threads())  # fmt: skip
    return out
