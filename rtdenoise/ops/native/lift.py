"""`lift` and `lower`, in one pass each."""

from __future__ import annotations

from ctypes import c_int64

import torch
from torch import Tensor

from ... import constants
from .compiler import library, pointer

CURVE = {name: getattr(constants, name) for name in dir(constants) if name.startswith("PU_")}
CURVE["GREY"] = constants.PIXELS_GREY


def lift(light: Tensor) -> Tensor:
    return _applied("lift", light)


def lower(lifted: Tensor) -> Tensor:
    return _applied("lower", lifted)


def _applied(name: str, x: Tensor) -> Tensor:
    x, (B, _, H, W) = x.contiguous(), x.shape
    out = torch.empty_like(x)
    run = getattr(library("lift", **CURVE), name)
    run(pointer(x), pointer(out), B, c_int64(H * W), torch.get_num_threads())
    return out
