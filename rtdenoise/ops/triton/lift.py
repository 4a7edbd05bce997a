"""`lift` and `lower`, in one pass each."""

from __future__ import annotations

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import PIXELS_GREY, PU_A, PU_B, PU_C, PU_D, PU_E, PU_F, PU_G, PU_X0, PU_X1, PU_Y0, PU_Y1
from .common import FLAT, flat_grid, place_flat
from .curve import compressed, expanded

CURVE = {"A": PU_A, "B": PU_B, "C": PU_C, "D": PU_D, "E": PU_E, "F": PU_F, "S": math.exp(PU_G / PU_E)}


@triton.jit
def _lift(light, out, plane, G, A, B, C, D, E, F, S, Y0, Y1, BLOCK: tl.constexpr):
    b, at, exists = place_flat(plane, BLOCK)
    at += b * 3 * plane
    mean = tl.zeros([BLOCK], tl.float32)
    for c in tl.static_range(3):
        mean += tl.load(light + at + c * plane, mask=exists, other=0.0) / 3
    for c in tl.static_range(3):
        y = tl.load(light + at + c * plane, mask=exists, other=0.0)
        y += G * (mean - y)
        power = (B * tl.exp(C * tl.log(tl.minimum(tl.maximum(y, Y0), Y1))) + D) / E
        dark = expanded(tl.where(y <= Y0, y * (A / E), power))
        tl.store(out + at + c * plane, tl.where(y <= Y1, dark, S * y + (S * F - 1)), mask=exists)


@triton.jit
def _lowered(x, A, B, C, D, E, F, S, X0, X1):
    value = E * compressed(x)
    power = tl.exp(tl.log((tl.minimum(tl.maximum(value, X0), X1) - D) / B) / C)
    dark = tl.where(value <= X0, value / A, power)
    return tl.where(value <= X1, dark, x / S + (1 / S - F))


@triton.jit
def _lower(lifted, out, plane, G, A, B, C, D, E, F, S, X0, X1, BLOCK: tl.constexpr):
    b, at, exists = place_flat(plane, BLOCK)
    at += b * 3 * plane
    red = _lowered(tl.load(lifted + at, mask=exists, other=0.0), A, B, C, D, E, F, S, X0, X1)
    green = _lowered(tl.load(lifted + at + plane, mask=exists, other=0.0), A, B, C, D, E, F, S, X0, X1)
    blue = _lowered(tl.load(lifted + at + 2 * plane, mask=exists, other=0.0), A, B, C, D, E, F, S, X0, X1)
    grey, scale = G * ((red + green + blue) / 3), 1 / (1 - G)
    tl.store(out + at, tl.maximum(red - grey, 0.0) * scale, mask=exists)
    tl.store(out + at + plane, tl.maximum(green - grey, 0.0) * scale, mask=exists)
    tl.store(out + at + 2 * plane, tl.maximum(blue - grey, 0.0) * scale, mask=exists)


def lift(light: Tensor) -> Tensor:
    light, (B, _, H, W) = light.contiguous(), light.shape
    out = torch.empty_like(light)
    _lift[flat_grid(B, H * W)](light, out, H * W, PIXELS_GREY, **CURVE, Y0=PU_Y0, Y1=PU_Y1, BLOCK=FLAT)
    return out


def lower(lifted: Tensor) -> Tensor:
    lifted, (B, _, H, W) = lifted.contiguous(), lifted.shape
    out = torch.empty_like(lifted)
    _lower[flat_grid(B, H * W)](lifted, out, H * W, PIXELS_GREY, **CURVE, X0=PU_X0, X1=PU_X1, BLOCK=FLAT)
    return out
