"""The curve on which networks that write pixels see light: deep shadows count, too, and pure colours are less pure."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ..constants import PIXELS_GREY, PU_A, PU_B, PU_C, PU_D, PU_E, PU_F, PU_G, PU_X0, PU_X1, PU_Y0, PU_Y1
from .dispatch import Fused, Support, falls_back

LIFT = Fused("lift.lift", native=Support(channels={"light": (3,)}), triton=Support(channels={"light": (3,)}))
LOWER = Fused("lift.lower", native=Support(channels={"lifted": (3,)}), triton=Support(channels={"lifted": (3,)}))
SLOPE = math.exp(PU_G / PU_E)  # of bright light


@falls_back
def lift(light: Tensor) -> Tensor:
    """Light `[B, C, H, W]` ≥ 0, at one exposure, such that its compressed value (`color.compress`) is that on OIDN's
    curve, in units of E (`constants`):

        log(1 + lift(y)) = PU((1 - g) y + g mean(y)) / E,    mean over colours, g = `constants.PIXELS_GREY`

    A lamp of one primary colour leaves others black, which OIDN's networks hardly know: they make blue light a tenth
    too bright, and in bytes a quarter too dark, but are right once a little of it is in the other colours.
    PU is nearly uniform to the eye (Aydın, Mantiuk and Seidel 2008; fitted in Open Image Denoise 2, Apache License
    2.0): a logarithm for bright light, a power for dark. log(1 + c y) is the same for bright light, and flat for dark:
    networks that learnt by PU fill deep shadows then.
    """
    if run := LIFT(light=light):
        return run(light)
    light = light + PIXELS_GREY * (light.mean(1, keepdim=True) - light)
    power = (PU_B * light.clamp(PU_Y0, PU_Y1) ** PU_C + PU_D) / PU_E
    dark = torch.where(light <= PU_Y0, light * (PU_A / PU_E), power).expm1()
    return torch.where(light <= PU_Y1, dark, SLOPE * light + (SLOPE * PU_F - 1))


@falls_back
def lower(lifted: Tensor) -> Tensor:
    """Inverse of `lift`, ≥ 0."""
    if run := LOWER(lifted=lifted):
        return run(lifted)
    value = PU_E * lifted.log1p()
    power = ((value.clamp(PU_X0, PU_X1) - PU_D) / PU_B) ** (1 / PU_C)
    dark = torch.where(value <= PU_X0, value / PU_A, power)
    light = torch.where(value <= PU_X1, dark, lifted / SLOPE + (1 / SLOPE - PU_F))
    return ((light - PIXELS_GREY * light.mean(1, keepdim=True)) / (1 - PIXELS_GREY)).clamp(min=0)
