"""Light of earlier frames, as bright as it is now.

A lamp that flickers, or a door that opens, changes light by less than the noise of a pixel, and of cells as small as
`recall` compares. Over windows of some thousand pixels it stands out. There history is neither thrown away nor too dark
or too bright, but multiplied by what has changed (docs/notes/relit.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import RELIT_CELL, RELIT_DARKER, RELIT_FROM, RELIT_MOST, RELIT_ROUNDING, RELIT_SIDES, RELIT_WHOLE
from .agrees import check_before
from .dispatch import Fused, Support, falls_back

OF_GAIN = Support(max_channels=7, channels={"before": (3,), "now": (3,), "found": (1,)}, bytes=("found",))
OF_IMAGE = Support(other=("gain",), channels={"gain": (3,)})
GAIN = Fused("relit.gain", native=OF_GAIN, triton=OF_GAIN)
RELIT = Fused("relit.relit_", native=OF_IMAGE, triton=OF_IMAGE)


@falls_back
def gain(
    before: Tensor,  # [B, 3, H, W] light of frames before, at this frame's pixels
    now: Tensor,  # [B, 3, H, W] this frame's
    found: Tensor,  # [B, 1, H, W] bool: where there is any of before
) -> Tensor:  # [B, 3, ⌈H/CELL⌉, ⌈W/CELL⌉] in [1/MOST², MOST²]
    """How much brighter light has become, in cells of CELL × CELL pixels: exp(g₁ + g₂), each linear between the middles
    of squares of cells, and 1 where noise may be all that has changed. In a square of SIDE × SIDE cells, over it and
    the eight around it,

        g = clamp((q - FROM) / (WHOLE - FROM), 0, 1) · log clamp(Σ now / Σ before, 1/MOST, MOST),
        q = |Σ d|² / (Σ |d|² + |ROUNDING Σ before|²),    d = sums of before - now over the quarters of squares,

    where `before` is multiplied by exp(g₁) once that is known, and sums are over the pixels that are `found`. Of the 36
    quarters q is 1 on average if what differs is noise, or texture that is looked up beside its place; and 36 if light
    is brighter everywhere by as much. Noise is skewed: where none of the rarest, brightest samples fell, light seems
    darker, so there q is divided by DARKER. `constants` has the numbers as RELIT_CELL, RELIT_SIDES (of g₁ and g₂) ...

    Raises ValueError where the shapes do not fit. No gradients.
    """
    check_before(now, before, found)
    before, now = before.detach(), now.detach()
    if run := GAIN(before=before, now=now, found=found.view(torch.uint8)):
        return run(before, now, found)
    cells = _summed(found * torch.cat([before, now], dim=1), RELIT_CELL)
    log = torch.zeros_like(cells[:, :3])
    for side in RELIT_SIDES:
        then, light = cells.split(3, dim=1)
        log = log + _brighter(then * log.exp(), light, side)
    return log.to(now.dtype).exp()


@falls_back
def relit_(image: Tensor, gain: Tensor) -> Tensor:
    """Multiply the first three channels of an image `[B, C ≥ 3, H, W]` by those of cells (`gain`), and return it. In
    place, but for gradients. Raises ValueError where the shapes do not fit."""
    (B, _, H, W), cells = image.shape, (-(-image.shape[2] // RELIT_CELL), -(-image.shape[3] // RELIT_CELL))
    if image.shape[1] < 3 or gain.shape != (B, 3, *cells):
        raise ValueError(f"expected an image [B, C ≥ 3, H, W] and its gain, got {tuple(image.shape)} and "
                         f"{tuple(gain.shape)}")  # fmt: skip
    passes = torch.is_grad_enabled() and image.requires_grad
    if not passes and image.is_contiguous() and (run := RELIT(image=image, gain=gain)):
        return run(image, gain)
    spread = F.interpolate(gain, scale_factor=RELIT_CELL)[:, :, :H, :W]
    if passes:
        return torch.cat([image[:, :3] * spread, image[:, 3:]], dim=1)
    image[:, :3] *= spread
    return image


def _brighter(before: Tensor, now: Tensor, side: int) -> Tensor:
    """g of each cell, from sums over cells."""
    h, w = now.shape[2:]
    quarters = _summed(torch.cat([before, now], dim=1), side // 2, side)
    then, light = quarters.split(3, dim=1)
    square = (then - light).square().sum(1, keepdim=True)
    sums = 9 * F.avg_pool2d(_summed(torch.cat([quarters, square], dim=1), 2), 3, stride=1, padding=1)
    then, light, square = sums.split([3, 3, 1], dim=1)
    least = (RELIT_ROUNDING * then).square().sum(1, keepdim=True)
    q = (then - light).square().sum(1, keepdim=True) / (square + least).clamp(min=1e-300)
    darker = light.sum(1, keepdim=True) < then.sum(1, keepdim=True)
    q = torch.where(darker, q / RELIT_DARKER, q)
    sure = ((q - RELIT_FROM) / (RELIT_WHOLE - RELIT_FROM)).clamp(0, 1)
    brighter = torch.where(then > 0, light / then.clamp(min=1e-300), 1).clamp(1 / RELIT_MOST, RELIT_MOST)
    spread = F.interpolate(sure * brighter.log(), scale_factor=side, mode="bilinear")
    return spread[:, :, :h, :w]


def _summed(image: Tensor, side: int, whole: int = 0) -> Tensor:
    """Sums over cells of `side` × `side` pixels, those beyond the picture being 0, in float64: squares are large. There
    are as many cells as make up whole ones of another size."""
    (H, W), whole = image.shape[2:], whole or side
    padded = F.pad(image.double(), (0, -W % whole, 0, -H % whole))
    return F.avg_pool2d(padded, side) * side**2
