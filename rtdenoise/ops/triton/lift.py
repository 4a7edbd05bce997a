"""`lift` and `lower`, in one pass each."""

from __future__ import annotations

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import PU_A, PU_B, PU_C, PU_D, PU_E, PU_F, PU_G, PU_X0, PU_X1, PU_Y0, PU_Y1
from .common import FLAT, flat_grid, place_flat
from .curve import compressed, expanded

CURVE = {"A": PU_A, "B": PU_B, "C": PU_C, "D": PU_D, "E": PU_E, "F": PU_F, "S": math.exp(PU_G / PU_E)}


@triton.jit
def _lift(light, out, count, A, B, C, D, E, F, S, Y0, Y1, BLOCK: tl.constexpr):
    _, at, exists = place_flat(count, BLOCK)
    y = tl.load(light + at, mask=exists, other=0.0)
    power = (B * tl.exp(C * tl.log(tl.minimum(tl.maximum(y, Y0), Y1))) + D) / E
    dark = expanded(tl.where(y <= Y0, y * (A / E), power))
    tl.store(out + at, tl.where(y <= Y1, dark, S * y + (S * F - 1)), mask=exists)


@triton.jit
def _lower(lifted, out, count, A, B, C, D, E, F, S, X0, X1, BLOCK: tl.constexpr):
    _, at, exists = place_flat(count, BLOCK)
    x = tl.load(lifted + at, mask=exists, other=0.0)
    value = E * compressed(x)
    power = tl.exp(tl.log((tl.minimum(tl.maximum(value, X0), X1) - D) / B) / C)
    dark = tl.where(value <= X0, value / A, power)
    tl.store(out + at, tl.where(value <= X1, dark, x / S + (1 / S - F)), mask=exists)


def lift(light: Tensor) -> Tensor:
    light = light.contiguous()
    out = torch.empty_like(light)
    _lift[flat_grid(1, light.numel())](light, out, light.numel(), **CURVE, Y0=PU_Y0, Y1=PU_Y1, BLOCK=FLAT)
    return out


def lower(lifted: Tensor) -> Tensor:
    lifted = lifted.contiguous()
    out = torch.empty_like(lifted)
    _lower[flat_grid(1, lifted.numel())](lifted, out, lifted.numel(), **CURVE, X0=PU_X0, X1=PU_X1, BLOCK=FLAT)
    return out
