"""How the pictures of a kernel network and of one that writes pixels become one: `ops.mix`, its shares, and what is
evened out before.

Kernels lag behind where light has changed: there the written pixels show alone. The image is the history of the next
frame: the kernel network averages it as its own (docs/notes/trust.md).
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import MIX_SEEN_ONCE, MIX_SHARES
from ..ops.around import greatest_around
from ..ops.mix import mix as mixture


def mix(
    kernels: Tensor,  # [B, 3, H, W] linear radiance, as the others
    pixels: Tensor,  # [B, 3, H, W]
    scale: Tensor,  # [B, 1, 1, 1] exposure
    trust: Tensor | float = 1.0,  # [B, 1, H, W] in [0, 1]
    before: Tensor | None = None,  # [B, 3, H, W]; None: there is none
    held: Tensor | float = 1.0,  # [B, 1, H, W] in [0, 1]: 0 where motion leads to no previous picture
    shares: tuple[float, float, float] = MIX_SHARES,
    noisy: Tensor | None = None,  # [B, 3, H, W] the frame; None: shares are as they are
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """`ops.mix`. Where a pixel was just uncovered and others around have a history, the noisy frame tells of these, not
    of it."""
    one = torch.ones_like(kernels[:, :1])
    trust, held = trust * one, held * one
    tells = held + (1 - held) * (1 - greatest_around(held)) if noisy is not None else None
    return mixture(kernels, pixels, scale, trust, shares, before, held, noisy, tells)


def evened(light: Tensor, count: Tensor, image: Tensor, trust: Tensor | float = 1.0) -> Tensor:
    """Averaged light `[B, 3, H, W]` with some of the denoised `image` where `count` `[B, 1, H, W]` frames, one to two,
    are in it and more in pixels around: networks that see a single picture take noise for texture where there is less
    of it nearby. As far as the image is trusted (`mix`). To the bit the light where one frame is in all pixels
    around."""
    once = 1 - (count - 1).clamp(0, 1)
    return torch.lerp(image, light, 1 - (1 - MIX_SEEN_ONCE) * trust * once * (greatest_around(count) - 1).clamp(0, 1))
