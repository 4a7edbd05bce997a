"""The layers of a frame without values that no filter can use."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ..frame import OFF_SCREEN
from . import pixels
from .dispatch import Fused, Support, falls_back

FUSED = Fused("replace_invalid", triton=Support())


@falls_back
def replace_invalid(
    layers: Mapping[str, Tensor],  # name -> [B, C, H, W]; the names are those of `limits`
    limits: Mapping[str, tuple[float, float]],  # name -> the smallest and the largest valid value (`sanitise.VALID`)
) -> dict[str, Tensor]:
    """Depth beyond its limits becomes 0 and motion that is not finite `OFF_SCREEN`. In other layers NaN and ±Inf become
    0, and other values are clamped. Valid layers come back unchanged to the bit, on a CPU as the same tensors."""
    if run := FUSED(layers=[*layers.values()]):
        return run(layers, limits)
    clean = dict(layers)
    for layer, tensor in layers.items():
        low, high = limits[layer]
        if tensor.device.type == "cpu" and pixels.within(tensor, low, high):
            continue  # looking is cheaper than writing; on a GPU it would mean waiting
        if layer == "depth":
            clean[layer] = torch.where((tensor > low) & (tensor <= high), tensor, 0.0)
        elif layer in ("motion", "motion_next"):
            clean[layer] = torch.nan_to_num(tensor, nan=OFF_SCREEN, posinf=OFF_SCREEN, neginf=OFF_SCREEN)
        else:
            clean[layer] = torch.nan_to_num(tensor, nan=0.0, posinf=0.0, neginf=0.0).clamp_(low, high)
    return clean
