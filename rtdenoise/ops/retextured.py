"""How far the texture of a surface has moved over it: a conveyor belt, running text, a film on a screen.

Motion vectors do not tell, and light is divided by albedo, so that it does not, either. What recent frames saw in a
pixel would be the mean of many textures (docs/notes/retextured.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import MOVED_LEAST, MOVED_MOST, RETEXTURED_LEAST, RETEXTURED_MOST, TURNED_CELL
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
    """The share of history that gives way to the frame, the greater of

        clamp((beyond - LEAST) / (MOST - LEAST), 0, 1)
        clamp((apart - MOVED_LEAST) / (MOVED_MOST - MOVED_LEAST), 0, 1)

    of how far albedo before lies beyond the least and greatest of 3×3 pixels of this frame, summed over channels, and
    of

        apart = |albedo - before|² - |albedo - that of a neighbour|²,

    of the neighbours to the right and below the one of which it is less: a texture of a few pixels has moved by more
    than one. All are means over the found pixels of a cell and the eight around it, of TURNED_CELL × TURNED_CELL pixels
    each. Albedo of another sample in the pixel, as noisy as it may be, hardly lies beyond, and is no farther away than
    that of neighbours. `constants` has the numbers as RETEXTURED_LEAST and RETEXTURED_MOST, and by these names.

    Raises ValueError where the shapes do not fit. No gradients.
    """
    check_before(albedo, before, found)
    H, W = albedo.shape[2:]
    if run := FUSED(albedo=albedo, before=before, found=found.view(torch.uint8)):
        return run(albedo, before, found)
    greatest, least = (F.max_pool2d(x, 3, stride=1, padding=1) for x in (albedo, -albedo))
    beyond = ((before - greatest).clamp(min=0) + (-least - before).clamp(min=0)).sum(1, keepdim=True)
    beside = F.pad(albedo, (0, 1, 0, 1), mode="replicate")
    right, below = beside[..., :-1, 1:], beside[..., 1:, :-1]
    apart = [((albedo - before).square() - (albedo - x).square()).sum(1, keepdim=True) for x in (right, below)]
    terms = torch.cat([beyond, *apart, torch.ones_like(beyond)], dim=1) * found
    terms = F.pad(terms, (0, -W % TURNED_CELL, 0, -H % TURNED_CELL))
    cells = F.avg_pool2d(F.avg_pool2d(terms, TURNED_CELL) * TURNED_CELL**2, 3, stride=1, padding=1) * 9
    beyond, across, down = (cells[:, :3] / cells[:, 3:].clamp(min=1)).split(1, dim=1)
    texture = ((beyond - RETEXTURED_LEAST) / (RETEXTURED_MOST - RETEXTURED_LEAST)).clamp(0, 1)
    moved = ((torch.minimum(across, down) - MOVED_LEAST) / (MOVED_MOST - MOVED_LEAST)).clamp(0, 1)
    share = torch.maximum(texture, moved)
    return F.interpolate(share, scale_factor=TURNED_CELL)[..., :H, :W]
