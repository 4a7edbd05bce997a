"""One picture of two that were denoised in different ways, and of the previous one.

With f(x) = log(1 + x), exposure s, the previous picture where each pixel was (`before`) and the trust t in history,

    mixed = t a · f(s · first) + (1 - t a) · f(s · other)
    image = f⁻¹(mixed + t h b · clamp(f(s · before) - mixed, -FAR, FAR)) / s

with the shares a and b, and h = 1 where there is such a previous picture, else 0 (`held`). Where the noisy frame is
known, a is what it tells (`share_told`): the more samples a pixel, the more that is. Where it tells of other pixels, a
is that, but not more than usual and not less than the last share. Of few samples its `word` counts as far as there is
noise: without, a sample differs from the truth by the place within the pixel that it saw, and both pictures have that,
too (docs/notes/trust.md).

In pixels that were just uncovered, where the frame tells of others (`tells` below `MIX_TELLS`), f(s · first) is at most
`MIX_UNCOVERED` from f(s · other): kernels spread what shines beside, and nothing has averaged that yet.

FAR (`constants.MIX_FAR`) bounds what the previous picture may add: a pixel that an edge partly covered then would leave
its light on what is there now, as a faint outline behind what moves.

In `hybrid` the first is the kernels' picture, which lags behind where light has changed: there the written one shows
alone. So it does before the sky, of which kernels know nothing: lone samples of smoke would be blots (`depth`). The
kernels average the mixture as their own history (docs/notes/trust.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import compress, expand
from ..constants import MIX_CELL, MIX_DARK, MIX_FAR, MIX_LARGEST, MIX_NOISE, MIX_TELLS, MIX_UNCOVERED
from .dispatch import ON_STACK, Fused, Support, falls_back

IMAGES = dict.fromkeys(("first", "other", "before", "noisy"), (3,))
IMAGES |= dict.fromkeys(("trust", "held", "tells", "depth"), (1,))
FUSED = Fused("mix", native=Support(max_width=ON_STACK, channels=IMAGES), triton=Support(channels=IMAGES))


@falls_back
def mix(
    first: Tensor,  # [B, 3, H, W] linear radiance, as the others
    other: Tensor,  # [B, 3, H, W]
    scale: Tensor,  # [B, 1, 1, 1] exposure
    trust: Tensor,  # [B, 1, H, W] in [0, 1]
    shares: tuple[float, float, float],  # the usual a, b, and the least a where the noisy frame tells of other pixels
    before: Tensor | None = None,  # [B, 3, H, W]; None: there is none
    held: Tensor | None = None,  # [B, 1, H, W] in [0, 1], read with `before`: 0 where motion leads to no such picture
    noisy: Tensor | None = None,  # [B, 3, H, W] the frame; None: shares are as they are
    tells: Tensor | None = None,  # [B, 1, H, W] in [0, 1], with `noisy`: how far it tells of the pixel
    depth: Tensor | None = None,  # [B, 1, H, W] of the frame: no a where 3×3 pixels hit nothing (0); None: all hit
    word: Tensor | None = None,  # [B, 1, 1, 1] in [0, 1], with `noisy`: how much it counts; None: wholly
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """The mixture; the equation stands above."""
    images = {"first": first, "other": other, "trust": trust, "before": before, "held": held, "noisy": noisy}
    if run := FUSED(**images, tells=tells, depth=depth):
        return run(first, other, scale, trust, shares, before, held, noisy, tells, depth, word)

    def shown(x: Tensor) -> Tensor:
        return compress(scale * x.clamp(min=0))

    share, kernels, written = shares[0], shown(first), shown(other)
    if noisy is not None:
        near = written + (kernels - written).clamp(-MIX_UNCOVERED, MIX_UNCOVERED)
        kernels = torch.where(tells < MIX_TELLS, near, kernels)
        told = share_told(noisy, first, other, scale, share)
        share = torch.lerp(told.clamp(shares[2], share), told, tells)
        share = share if word is None else torch.lerp(torch.full_like(share, shares[0]), share, word)
    if depth is not None:
        share = share * (F.max_pool2d(depth, 3, stride=1, padding=1) > 0)
    mixed = torch.lerp(written, kernels, trust * share)
    if before is not None:
        mixed = mixed + trust * shares[1] * held * (shown(before) - mixed).clamp(-MIX_FAR, MIX_FAR)
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
    relative = scale / (scale * mixture.mean(1, keepdim=True) + MIX_DARK)
    apart, left, noise = (relative * x for x in (first - other, noisy - other, noisy - mixture))
    left, noise = left.clamp(max=MIX_LARGEST), noise.clamp(max=MIX_LARGEST)
    parts = [x.sum(1, keepdim=True) for x in (apart * left, apart.square(), noise.square())]
    along, square, noise = _around(torch.cat(parts, dim=1)).split(1, dim=1)
    noise = noise + MIX_NOISE
    return ((usual * noise + along) / (noise + square)).clamp(0, 1)


def _around(x: Tensor) -> Tensor:
    """Means over cells of `MIX_CELL` × `MIX_CELL` pixels and the eight around them, `[B, C, H, W]`, linear between
    cells."""
    H, W = x.shape[2:]
    cells = F.avg_pool2d(x, MIX_CELL, ceil_mode=True, count_include_pad=False)
    cells = F.avg_pool2d(cells, 3, stride=1, padding=1, count_include_pad=False)
    return F.interpolate(cells, scale_factor=MIX_CELL, mode="bilinear", align_corners=False)[..., :H, :W]
