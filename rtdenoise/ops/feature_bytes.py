"""A picture's light and surfaces as bytes, the input of a network in bytes (`convolve_bytes`)."""

from __future__ import annotations

import torch
from torch import Tensor

from ..color import compress
from .dispatch import Fused, Support, falls_back

FUSED = Fused("feature_bytes", native=Support(channels={"layers": (3, 3, 3)}))
LIGHT, SURFACE = 40.0, 255.0  # bytes' steps in a unit of compressed light, and of albedo and normal
CHANNELS = 12  # of the result


@falls_back
def feature_bytes(
    light: Tensor,  # [B, 3, H, W] linear, ≥ 0
    albedo: Tensor,  # [B, 3, H, W] in [0, 1]
    normal: Tensor,  # [B, 3, H, W] in [-1, 1]
) -> Tensor:  # [B, CHANNELS, H, W] uint8, channels last
    """Whole steps of log(1 + light), of albedo and of half a normal and 0.5, by channels:

        0-2    light, at most 255 steps
        3-5    the steps of light beyond
        6-8    albedo
        9-11   normal

    Light of two bytes has steps of 2.5 % and ends at exp(2 · 255 / LIGHT) = 344 000.
    """
    layers = light, albedo, normal
    if run := FUSED(layers=layers):
        return run(*layers)
    steps = (compress(light) * LIGHT).round()
    parts = torch.cat([steps, steps - 255, *((x * SURFACE).round() for x in (albedo, 0.5 * normal + 0.5))], dim=1)
    return parts.clamp(0, 255).to(torch.uint8, memory_format=torch.channels_last)
