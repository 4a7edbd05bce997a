"""How far the texture of a surface has moved over it: a conveyor belt, running text, a film on a screen.

Motion vectors do not tell, and light is divided by albedo, so that it does not, either. What recent frames saw in a
pixel would be the mean of many textures (docs/notes/retextured.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import RETEXTURED_LEAST, RETEXTURED_MOST, TURNED_CELL
from .agrees import check_before
from .dispatch import Fused, Support, falls_back

SUPPORT = Support(max_channels=3, channels={"albedo": (3,), "before": (3,), "found": (1,)}, bytes=("found",))
FUSED = Fused("retextured", native=SUPPORT)


@falls_back
def retextured(
    albedo: Tensor,  # [B, 3, H, W] of the current frame
    before: Tensor,  # [B, 3, H, W] of the same surfaces in frames before, one or their mean (`reproject`)
    found: Tensor,  # [B, 1, H, W] bool: where there is any
) -> Tensor:  # [B, 1, H, W] in [0, 1]
    """The share of history that gives way to the frame:

        clamp((beyond - LEAST) / (MOST - LEAST), 0, 1)

    of how far albedo before lies beyond the least and greatest of 3×3 pixels of this frame, summed over channels; its
    mean over the found pixels of a cell and the eight around it, of TURNED_CELL × TURNED_CELL pixels each. Albedo of
    another sample in the pixel, as noisy as it may be, hardly lies beyond. `constants` has the numbers as
    RETEXTURED_LEAST and RETEXTURED_MOST.

    Raises ValueError where the shapes do not fit. No gradients.
    """
    check_before(albedo, before, found)
    H, W = albedo.shape[2:]
    if run := FUSED(albedo=albedo, before=before, found=found.view(torch.uint8)):
        return run(albedo, before, found)
    greatest, least = (F.max_pool2d(x, 3, stride=1, padding=1) for x in (albedo, -albedo))
    beyond = ((before - greatest).clamp(min=0) + (-least - before).clamp(min=0)).sum(1, keepdim=True)
    terms = torch.cat([beyond, torch.ones_like(beyond)], dim=1) * found
    terms = F.pad(terms, (0, -W % TURNED_CELL, 0, -H % TURNED_CELL))
    cells = F.avg_pool2d(F.avg_pool2d(terms, TURNED_CELL) * TURNED_CELL**2, 3, stride=1, padding=1) * 9
    mean = cells[:, :1] / cells[:, 1:].clamp(min=1)
    share = ((mean - RETEXTURED_LEAST) / (RETEXTURED_MOST - RETEXTURED_LEAST)).clamp(0, 1)
    return F.interpolate(share, scale_factor=TURNED_CELL)[..., :H, :W]
