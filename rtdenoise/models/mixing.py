"""How the pictures of a kernel network and of one that writes pixels become one.

With f(x) = log(1 + x), exposure s, the previous picture where each pixel was (`before`) and the trust t in the kernel
network's history, 1 - its reset where there is a history,

    mixed = t a · f(s · kernels) + (1 - t a) · f(s · pixels)
    image = f⁻¹(t b · f(s · before) + (1 - t b) · mixed) / s

with the shares a and b. Kernels lag behind where light has changed: there the written pixels show alone. The image is
the history of the next frame: the kernel network averages it as its own (docs/notes/trust.md).

Where the noisy frame is known, a is what it tells (`share_told`): the more samples a pixel, the more that is.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import compress, expand

KERNELS, BEFORE = 0.4, 0.1  # the shares a and b
CELL = 16  # pixels, of `greatest_around`
FINE = 4  # pixels, of `_around`
DARK = 0.05  # exposed light: differences of darker light count less than in proportion
LARGEST = 1e6  # of relative differences: their squares stay finite
NOISE = 1e-6  # of their squares, that is there at least: pictures without noise that are alike tell nothing
SEEN_ONCE = 0.6  # share of the noisy light where one frame has seen a pixel, and others have a history (`evened`)


def mix(
    kernels: Tensor,  # [B, 3, H, W] linear radiance, as the others
    pixels: Tensor,  # [B, 3, H, W]
    scale: Tensor,  # [B, 1, 1, 1] exposure
    trust: Tensor | float = 1.0,  # [B, 1, H, W] in [0, 1]
    before: Tensor | None = None,  # [B, 3, H, W]; None: there is none
    held: Tensor | float = 1.0,  # [B, 1, H, W] in [0, 1]: 0 where motion leads to no previous picture
    shares: tuple[float, float] = (KERNELS, BEFORE),
    noisy: Tensor | None = None,  # [B, 3, H, W] the frame; None: shares are as they are
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """The mixture; the equation stands above."""

    def shown(x: Tensor) -> Tensor:
        return compress(scale * x.clamp(min=0))

    share = shares[0]
    if noisy is not None:
        share = share + _alike(held) * (share_told(noisy, kernels, pixels, scale, share) - share)
    mixed = torch.lerp(shown(pixels), shown(kernels), trust * share)
    if before is not None:
        mixed = torch.lerp(mixed, shown(before), trust * shares[1] * held)
    return expand(mixed) / scale


@torch.no_grad()
def share_told(noisy: Tensor, first: Tensor, other: Tensor, scale: Tensor, usual: float) -> Tensor:
    """The share a of the first of two pictures, `[B, 1, H, W]` in [0, 1]: between the `usual` one, and the one that
    brings their mixture closest to the noisy frame. With the frame y, the pictures p and q, their usual mixture m, all
    relative to the brightness of m, and sums Σ over the pixels around (`_around`) and colours,

        a = clamp((usual · Σ (y - m)² + Σ (p - q)(y - q)) / (Σ (y - m)² + Σ (p - q)²), 0, 1)

    (y - m)² is noise. At 1 sample a pixel it is far more than (p - q)², and the frame tells little; at 16 it tells
    where one of the pictures has been smoothed too much. As the sums are over many pixels it could tell more, if y had
    no part in p and q (docs/notes/trust.md).
    """
    mixture = torch.lerp(other, first, usual)
    relative = scale / (scale * mixture.mean(1, keepdim=True) + DARK)
    apart, left, noise = (relative * x for x in (first - other, noisy - other, noisy - mixture))
    left, noise = left.clamp(max=LARGEST), noise.clamp(max=LARGEST)
    parts = [x.sum(1, keepdim=True) for x in (apart * left, apart.square(), noise.square())]
    along, square, noise = _around(torch.cat(parts, dim=1)).split(1, dim=1)
    noise = noise + NOISE
    return ((usual * noise + along) / (noise + square)).clamp(0, 1)


def _alike(held: Tensor | float) -> Tensor | float:
    """Where the pixels around are like this one, `[B, 1, H, W]` in {0, 1}: not where it was just uncovered and others
    have a history, which tell of that."""
    if not isinstance(held, Tensor):
        return 1.0
    held = held.float()
    return held + (1 - held) * (1 - greatest_around(held))


def _around(x: Tensor) -> Tensor:
    """Means over cells of `FINE` × `FINE` pixels and the eight around them, `[B, C, H, W]`, linear between cells."""
    H, W = x.shape[2:]
    cells = F.avg_pool2d(x, FINE, ceil_mode=True, count_include_pad=False)
    cells = F.avg_pool2d(cells, 3, stride=1, padding=1, count_include_pad=False)
    return F.interpolate(cells, scale_factor=FINE, mode="bilinear", align_corners=False)[..., :H, :W]


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
