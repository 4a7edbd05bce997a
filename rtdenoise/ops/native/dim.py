"""`dim`: only pixels above the usual brightness look at those around them."""

from __future__ import annotations

from ctypes import c_float

import torch
from torch import Tensor

from ...constants import LUMINANCE_WEIGHTS
from .compiler import library, pointer


def dim(radiance: Tensor, usual: Tensor, limit: float) -> Tensor:
    radiance, usual = radiance.contiguous(), usual.contiguous()
    (B, _, H, W), out = radiance.shape, torch.empty_like(radiance)
    run = library("dim", **dict(zip(("RED", "GREEN", "BLUE"), LUMINANCE_WEIGHTS, strict=True))).dim
    run(*map(pointer, (radiance, usual, out)), c_float(limit), B, H, W, torch.get_num_threads())
    return out
