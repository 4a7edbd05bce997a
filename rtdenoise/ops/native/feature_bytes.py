"""`feature_bytes`: planes are compressed, rounded and transposed in one pass."""

from __future__ import annotations

from ctypes import c_int64

import torch
from torch import Tensor

from ..feature_bytes import CHANNELS, LIGHT, SURFACE
from .compiler import library, planes, pointer


def feature_bytes(light: Tensor, albedo: Tensor, normal: Tensor) -> Tensor:
    layers = [layer.contiguous() for layer in (light, albedo, normal)]
    B, _, H, W = light.shape
    out = torch.empty(B, CHANNELS, H, W, dtype=torch.uint8, device="cpu", memory_format=torch.channels_last)
    constants = {"LIGHT": LIGHT, "SURFACE": SURFACE, "CHANNELS": CHANNELS}
    run = library("feature_bytes", **constants).feature_bytes
    for b in range(B):
        each = planes([layer[b : b + 1] for layer in layers])
        run(each, pointer(out[b]), c_int64(H * W), torch.get_num_threads())
    return out
