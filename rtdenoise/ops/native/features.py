"""`features`, channels last: planes are transposed, compressed and converted in one pass."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_float, c_int64

import torch
from torch import Tensor

from ..features import filled
from .compiler import library, planes, pointer


def features(
    light: Sequence[Tensor], guides: Sequence[Tensor], scale: Tensor, dtype: torch.dtype, unit: float, lanes: int
) -> Tensor:
    layers = [layer.float().contiguous() for layer in (*light, *guides)]
    B, _, H, W = layers[0].shape
    channels, lit = (sum(layer.shape[1] for layer in group) for group in (layers, light))
    out = torch.empty(B, channels, H, W, dtype=dtype, device="cpu", memory_format=torch.channels_last)
    run = library("features", C=channels, LIGHT=lit, HALF=int(dtype == torch.bfloat16), UNIT=unit).features
    for b in range(B):
        each = planes([layer[b : b + 1] for layer in layers])
        run(each, c_float(scale[b].item()), pointer(out[b]), c_int64(H * W), torch.get_num_threads())
    return filled(out, lanes)
