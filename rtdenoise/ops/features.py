"""A network's input, in one tensor."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..color import compress
from .dispatch import Fused, Support, falls_back

FUSED = Fused("features", native=Support())  # channels last only, to one of `TYPES`
TYPES = torch.float32, torch.bfloat16


@falls_back
def features(
    light: Sequence[Tensor],  # [B, C, H, W] each, ≥ 0: linear light
    guides: Sequence[Tensor],  # [B, C, H, W] each, float or bool: all other layers
    scale: Tensor,  # [B, 1, 1, 1] exposure: light is multiplied by it
    like: Tensor,  # gives the dtype and, if it has 4 axes, the memory format of the result
) -> Tensor:  # [B, ΣC, H, W]
    """Light, compressed by `color.compress` at one exposure, then the guides, in the order given:

    out[b, :, y, x] = [log(1 + scale[b] · light[b, :, y, x]), guides[b, :, y, x]]
    """
    last = not like.is_contiguous() and like.is_contiguous(memory_format=torch.channels_last)
    form = {"dtype": like.dtype, "memory_format": torch.channels_last if last else torch.contiguous_format}
    guides = [guide.to(light[0].dtype) for guide in guides]
    if last and like.dtype in TYPES and (run := FUSED(light=light, guides=guides)):
        return run(light, guides, scale, like.dtype)
    return torch.cat([compress(torch.cat([*light], dim=1) * scale), *guides], dim=1).to(**form)
