"""`convolve`: mixtures of inputs and a block of sums stay in the caches until all of their products are summed."""

from __future__ import annotations

from ctypes import byref

import torch
from torch import Tensor

from ..convolve import MOST
from .compiler import library, pointer
from .convolve_bytes import Source


def convolve(x: Tensor, weight: Tensor, bias: Tensor, of_mixtures: Tensor, below: Tensor | None) -> Tensor:
    B, C, H, W = x.shape
    O, bias = len(weight), bias.contiguous()
    out = torch.empty(B, O, H, W, dtype=x.dtype, device="cpu", memory_format=torch.channels_last)
    run = library("convolve", MOST=MOST).convolve
    for b in range(B):
        beside = Source(x[b].data_ptr(), H, W, C, 3, 1)
        coarse = Source() if below is None else Source(below[b].data_ptr(), H // 2, W // 2, below.shape[1], 3, 1)
        run(byref(coarse), byref(beside), *map(pointer, (of_mixtures, bias, out[b])), of_mixtures.shape[1], O, H, W,
            torch.get_num_threads())  # fmt: skip
    return out
