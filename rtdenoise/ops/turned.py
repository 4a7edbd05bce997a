"""How far surfaces have turned, and how far history gives way to that.

What a surface reflects moves otherwise than it does: where it turns, its history shows other light. Light of one sample
a pixel is too noisy to tell, normals are not (docs/notes/turned.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import TURNED_ANGLE, TURNED_CELL, TURNED_NOISE
from .dispatch import Fused, Support, falls_back

SUPPORT = Support(channels={"normal": (3,), "before": (3,)})
FUSED = Fused("turned", native=SUPPORT, triton=SUPPORT)


@falls_back
def turned(
    normal: Tensor,  # [B, 3, H, W] of the current frame
    before: Tensor,  # [B, 3, H, W] of the same surfaces in the previous one (`reproject`), 0 where there is none
) -> Tensor:  # [B, 1, H, W] in [0, 1)
    """The share of history that gives way to the frame, from the angle by which a surface has turned since:

        1 - exp(-angle / ANGLE),    angle = |Σ d| / n · max(0, 1 - NOISE · Σ |d|² / |Σ d|²)

    with the differences d of the unit normals, over the n pixels that have both, in cells of CELL × CELL pixels and the
    eight around them. Σ d is that of a turn where |Σ d|² / Σ |d|² is large: it is 1 on average if the differences are
    noise, as where one sample a pixel falls on leaves or grain. A surface that turns about its normal counts as still.
    `constants` has the numbers as TURNED_ANGLE (radians), TURNED_NOISE and TURNED_CELL.

    Raises ValueError where the shapes do not fit. No gradients.
    """
    if normal.shape != before.shape or normal.ndim != 4 or normal.shape[1] != 3:
        raise ValueError(f"expected two images [B, 3, H, W], got {tuple(normal.shape)} and {tuple(before.shape)}")
    if run := FUSED(normal=normal, before=before):
        return run(normal, before)
    H, W = normal.shape[2:]
    (now, has), (then, had) = _unit(normal), _unit(before)
    both = (has & had).to(normal.dtype)
    difference = both * (now - then)
    terms = torch.cat([difference, difference.square().sum(1, keepdim=True), both], dim=1)
    cells = F.avg_pool2d(F.pad(terms, (0, -W % TURNED_CELL, 0, -H % TURNED_CELL)), TURNED_CELL) * TURNED_CELL**2
    sums = 9 * F.avg_pool2d(cells, 3, stride=1, padding=1)
    square, noise, count = sums[:, :3].square().sum(1, keepdim=True), sums[:, 3:4], sums[:, 4:]
    sure = (1 - TURNED_NOISE * noise / square.clamp(min=1e-30)).clamp(min=0)
    angle = sure * square.sqrt() / count.clamp(min=1)
    return F.interpolate(-torch.expm1(-angle / TURNED_ANGLE), scale_factor=TURNED_CELL)[..., :H, :W]


def _unit(normal: Tensor) -> tuple[Tensor, Tensor]:
    """Normals of length 1, and where there are any."""
    square = normal.square().sum(1, keepdim=True)
    return normal / square.clamp(min=1e-12).sqrt(), square > 0
