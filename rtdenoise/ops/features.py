"""What a network sees of a frame, in one tensor."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..color import compress
from .path import fused


def features(
    light: Sequence[Tensor],  # [B, C, H, W] each, ≥ 0: linear light
    guides: Sequence[Tensor],  # [B, C, H, W] each, float or bool: all else
    scale: Tensor,  # [B, 1, 1, 1] what light is multiplied by
    like: Tensor,  # of the dtype and, for 4 axes, in the memory format that is wanted
) -> Tensor:  # [B, ΣC, H, W]
    """A network's input: light as it is `compress`ed at one exposure, then the guides, in the order given.

    out[b, :, y, x] = [log(1 + scale[b] · light[b, :, y, x]), guides[b, :, y, x]]
    """
    last = not like.is_contiguous() and like.is_contiguous(memory_format=torch.channels_last)
    form = {"dtype": like.dtype, "memory_format": torch.channels_last if last else torch.contiguous_format}
    guides = [guide.to(light[0].dtype) for guide in guides]
    if last and (run := fused("features", *light, *guides)):
        return run(light, guides, scale, like.dtype)
    return torch.cat([compress(torch.cat([*light], dim=1) * scale), *guides], dim=1).to(**form)
