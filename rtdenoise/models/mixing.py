"""How the pictures of a kernel network and of one that writes pixels become one.

With f(x) = log(1 + x), exposure s, the previous picture where each pixel was (`before`) and the trust t in the kernel
network's history, 1 - its reset where there is a history,

    mixed = t a · f(s · kernels) + (1 - t a) · f(s · pixels)
    image = f⁻¹(t b · f(s · before) + (1 - t b) · mixed) / s

with the shares a and b. Kernels lag behind where light has changed: there the written pixels show alone. The image is
the history of the next frame: the kernel network averages it as its own (docs/notes/trust.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import compress, expand

KERNELS, BEFORE = 0.4, 0.1  # the shares a and b
CELL = 16  # pixels, of `greatest_around`
SEEN_ONCE = 0.6  # share of the noisy light where one frame has seen a pixel, and others have a history (`evened`)


def mix(
    kernels: Tensor,  # [B, 3, H, W] linear radiance, as the others
    pixels: Tensor,  # [B, 3, H, W]
    scale: Tensor,  # [B, 1, 1, 1] exposure
    trust: Tensor | float = 1.0,  # [B, 1, H, W] in [0, 1]
    before: Tensor | None = None,  # [B, 3, H, W]; None: there is none
    held: Tensor | float = 1.0,  # [B, 1, H, W] in [0, 1]: 0 where motion does not lead to `before`
    shares: tuple[float, float] = (KERNELS, BEFORE),
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """The mixture; the equation stands above."""

    def shown(x: Tensor) -> Tensor:
        return compress(scale * x.clamp(min=0))

    mixed = torch.lerp(shown(pixels), shown(kernels), trust * shares[0])
    if before is not None:
        mixed = torch.lerp(mixed, shown(before), trust * shares[1] * held)
    return expand(mixed) / scale


def evened(light: Tensor, count: Tensor, image: Tensor, trust: Tensor | float = 1.0) -> Tensor:
    """Averaged light `[B, 3, H, W]` with some of the denoised `image` where `count` `[B, 1, H, W]` frames, one to two,
    are in it and more in pixels around: networks that see a single picture take noise for texture where there is less
    of it nearby. As far as the image is trusted (`mix`). To the bit the light where one frame is in all pixels
    around."""
    once = 1 - (count - 1).clamp(0, 1)
    return torch.lerp(image, light, 1 - (1 - SEEN_ONCE) * trust * once * (greatest_around(count) - 1).clamp(0, 1))


def greatest_around(x: Tensor) -> Tensor:
    """The greatest values of `[B, C, H, W]` in cells of `CELL` × `CELL` pixels and the eight around them."""
    H, W = x.shape[2:]
    x = F.max_pool2d(F.max_pool2d(x, CELL, ceil_mode=True), 3, stride=1, padding=1)
    return F.interpolate(x, scale_factor=CELL, mode="nearest")[..., :H, :W]
