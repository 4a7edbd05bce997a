"""`to_planes`: no converted copy of the features, and no registers for planes that are not there."""

from __future__ import annotations

from ctypes import c_int

import torch
from torch import Tensor

from .compiler import library, pointer


def to_planes(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    B, C, H, W = x.shape
    half = x.dtype == torch.bfloat16
    half_taps = half and weight.dtype == torch.bfloat16
    taps = (weight if half_taps else weight.float()).permute(2, 3, 0, 1).contiguous()  # [3, 3, O, C]
    bias = bias.float().contiguous()
    out = bias.new_empty(B, len(bias), H, W)
    run = library("to_planes", C=C, O=len(bias), HALF=int(half), HALF_TAPS=int(half_taps)).to_planes
    for image, planes in zip(x, out, strict=True):
        run(*map(pointer, (image, taps, bias, planes)), c_int(H), c_int(W), torch.get_num_threads())
    return out
