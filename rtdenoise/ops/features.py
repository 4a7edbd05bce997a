"""A network's input, in one tensor."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import compress
from .dispatch import Fused, Support, falls_back

# Channels last only, to one of `TYPES`.
FUSED = Fused("features", native=Support(bytes=("flags",)), triton=Support(bytes=("flags",)))
TYPES = torch.float32, torch.bfloat16


@falls_back
def features(
    light: Sequence[Tensor],  # [B, C, H, W] each, ≥ 0: linear light
    guides: Sequence[Tensor],  # [B, C, H, W] each, float or bool: all other layers
    scale: Tensor,  # [B, 1, 1, 1] exposure: light is multiplied by it
    like: Tensor,  # gives the dtype and, if it has 4 axes, the memory format of the result
    unit: float = 1.0,  # of light: it is multiplied by it in the end
    lanes: int = 1,
) -> Tensor:  # [B, ΣC, H, W]; zeros fill the channels up to a multiple of `lanes`
    """Light, compressed by `color.compress` at one exposure, then the guides, in the order given:

    out[b, :, y, x] = [unit · log(1 + scale[b] · light[b, :, y, x]), guides[b, :, y, x]]

    A logarithm is rounded to the dtype before the unit multiplies it.
    """
    last = not like.is_contiguous() and like.is_contiguous(memory_format=torch.channels_last)
    form = {"dtype": like.dtype, "memory_format": torch.channels_last if last else torch.contiguous_format}
    if last and like.dtype in TYPES:
        guides = [guide if guide.dtype is torch.bool else guide.to(light[0].dtype) for guide in guides]
        flags = [guide.view(torch.uint8) for guide in guides if guide.dtype is torch.bool]
        if run := FUSED(light=light, guides=[x for x in guides if x.dtype is not torch.bool], flags=flags):
            return run(light, guides, scale, like.dtype, unit, lanes)
    guides = [guide.to(light[0].dtype) for guide in guides]
    compressed = compress(torch.cat([*light], dim=1) * scale)
    out = torch.cat([compressed, *guides], dim=1).to(**form)
    lit = compressed.shape[1]
    out = out if unit == 1 else torch.cat([out[:, :lit] * unit, out[:, lit:]], dim=1)
    return filled(out, lanes)


def filled(x: Tensor, lanes: int) -> Tensor:
    """`x` with zeros for channels up to a multiple of `lanes`."""
    return F.pad(x, (0, 0, 0, 0, 0, -x.shape[1] % lanes)) if x.shape[1] % lanes else x
