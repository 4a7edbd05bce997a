"""How far a picture has moved otherwise than motion says: least squares over cells of pixels (Lucas and Kanade, An
Iterative Image Registration Technique, 1981).

For the displacement d of a cell, Σ w (y(p) - y'(p + motion(p) + d))² is least where

    d = (Σ w g gᵀ)⁻¹ Σ w g e,    e = y(p) - y'(p + motion(p)),    g = ∇y'(p + motion(p))

The sums are of one lookup; each further round begins where the last one led.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import luminance
from ..constants import DEPTH_TOLERANCE, SHIFT_AROUND, SHIFT_BRIGHTNESS, SHIFT_ROUNDS, SHIFT_STRIDE
from ..motion import on_screen
from ..ops import warp
from ..ops.dispatch import Fused, Support, falls_back

LAYERS = dict.fromkeys(("now", "before", "here", "depth", "was"), (1,)) | {"motion": (2,)}
SUMS = Support(other=("shift",), channels=LAYERS)
FUSED = Fused("displacement_sums", native=SUMS, triton=SUMS)
ALL_ROUNDS = Fused("displacement_sums.displacement", triton=Support(channels=LAYERS))
COMPRESSED = Fused("compressed", triton=Support(channels=dict.fromkeys(("now", "before"), (3,))))


@falls_back
def displacement_sums(
    now: Tensor,  # [B, 1, H, W] y, a picture's luminance
    before: Tensor,  # [B, 1, H, W] y', that of the frame before
    motion: Tensor,  # [B, 2, H, W] pixels, to the frame before
    shift: Tensor,  # [B, 2, ⌈H/cell⌉, ⌈W/cell⌉] pixels that are added to it, linear between the cells' middles
    here: Tensor,  # [B, 1, H, W] in [0, 1]: how much a pixel counts
    depth: Tensor,  # [B, 1, H, W]
    depth_before: Tensor,  # [B, 1, H, W]
    cell: int,  # side in pixels
    stride: int,  # every so many pixels along either axis are looked at
) -> Tensor:  # [B, 7, ⌈H/cell⌉, ⌈W/cell⌉]
    """Sums over cells of w (1, g_x², g_x g_y, g_y², g_x e, g_y e, e²), as above. A pixel counts where motion led to the
    same depth on the screen. Lookups are bilinear, slopes central differences."""
    B, _, H, W = now.shape
    images = {"now": now, "before": before, "motion": motion, "here": here, "depth": depth, "was": depth_before}
    if shift.shape == (B, 2, -(-H // cell), -(-W // cell)) and (run := FUSED(**images, shift=shift)):
        return run(now, before, motion, shift, here, depth, depth_before, cell, stride, DEPTH_TOLERANCE)
    motion = motion + spread(shift, cell, H, W)
    known = torch.cat([before, *_slopes(before), depth_before], dim=1)
    seen = on_screen(motion)
    value, x, y, far = warp(known, motion).split(1, dim=1)
    looked_at = torch.zeros_like(here)
    looked_at[..., ::stride, ::stride] = here[..., ::stride, ::stride]
    weight = looked_at * seen * ((depth - far).abs() <= DEPTH_TOLERANCE * torch.maximum(depth, far))
    apart = now - value
    products = (torch.ones_like(x), x * x, x * y, y * y, x * apart, y * apart, apart * apart)
    terms = F.pad(torch.cat([weight * product for product in products], dim=1), (0, -W % cell, 0, -H % cell))
    return F.avg_pool2d(terms, cell) * cell**2


@falls_back
def displacement(*pictures: Tensor, cell: int, damping: float) -> tuple[Tensor, Tensor]:
    """The displacement of each cell, `[B, 2, h, w]` pixels (x, y), 0 where there is too little to tell by; and the
    share of Σ w e² that is left with it, `[B, 1, h, w]`, by the last round's slopes. `pictures` are the arguments of
    `displacement_sums` without `shift`; `damping` is added to the mean of g²."""
    if run := ALL_ROUNDS(**dict(zip(("now", "before", "motion", "here", "depth", "was"), pictures, strict=True))):
        return run(*pictures, cell=cell, damping=damping)
    now, before, motion, *others = pictures
    shift, first = motion.new_zeros(len(now), 2, *(-(-n // cell) for n in now.shape[2:])), None
    for _ in range(SHIFT_ROUNDS):
        sums = displacement_sums(now, before, motion, shift, *others, cell, SHIFT_STRIDE)
        sums = F.avg_pool2d(sums, SHIFT_AROUND, stride=1, padding=SHIFT_AROUND // 2) * SHIFT_AROUND**2
        count, xx, xy, yy, x, y, square = sums.split(1, dim=1)
        first = square if first is None else first
        xx, yy = (each + damping * count + 1e-6 for each in (xx, yy))
        change = torch.cat([yy * x - xy * y, xx * y - xy * x], dim=1) / (xx * yy - xy * xy)
        change = change * (count > cell * SHIFT_AROUND / SHIFT_STRIDE**2)
        shift = shift + change
    left = square - (change * torch.cat([x, y], dim=1)).sum(1, keepdim=True)
    return shift, left / first.clamp(min=1e-30)


@falls_back
def compressed(now: Tensor, before: Tensor, blurred: bool = False) -> tuple[Tensor, Tensor]:
    """log(1 + s x) of the luminance x of two pictures `[B, 3, H, W]`, `[B, 1, H, W]` each; s x is SHIFT_BRIGHTNESS at
    the mean of the first. `blurred`: means of that over 3×3 pixels."""
    if run := COMPRESSED(now=now, before=before):
        return run(now, before, blurred)
    now, before = luminance(now), luminance(before)
    scale = SHIFT_BRIGHTNESS / now.mean((1, 2, 3), keepdim=True).clamp(min=1e-12)
    pictures = (x.mul_(scale).add_(1).log_() for x in (now, before))
    return tuple(_blurred(x) if blurred else x for x in pictures)


def spread(cells: Tensor, cell: int, H: int, W: int) -> Tensor:
    """Cells `[B, C, h, w]` to pixels `[B, C, H, W]`, linear between their middles."""
    return F.interpolate(cells, scale_factor=cell, mode="bilinear", align_corners=False)[..., :H, :W]


def _slopes(x: Tensor) -> tuple[Tensor, Tensor]:
    """∂/∂x and ∂/∂y."""
    x = F.pad(x, (1, 1, 1, 1), mode="replicate")
    return (x[..., 1:-1, 2:] - x[..., 1:-1, :-2]) / 2, (x[..., 2:, 1:-1] - x[..., :-2, 1:-1]) / 2


def _blurred(x: Tensor) -> Tensor:
    """Means over 3×3 pixels."""
    x = F.pad(x, (1, 1, 1, 1), mode="replicate")
    x = (x[:, :, :-2] + x[:, :, 1:-1]).add_(x[:, :, 2:])
    return (x[..., :-2] + x[..., 1:-1]).add_(x[..., 2:]).div_(9)
