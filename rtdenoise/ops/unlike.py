"""How many pixels of a frame find another surface at the end of their motion: whether it goes on with its shot."""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import CUT_ALIKE
from .alike import alike
from .dispatch import Fused, Support, falls_back
from .fetch import fetch
from .targets import on_screen

IMAGES = {"depth": (1,), "normal": (3,), "motion": (2,), "depth_before": (1,), "normal_before": (3,)}
FUSED = Fused("unlike", native=Support(channels=IMAGES))


@falls_back
def unlike(
    depth: Tensor,  # [B, 1, H, W] of the current frame
    normal: Tensor,  # [B, 3, H, W]
    motion: Tensor,  # [B, 2, H, W] to the frame before
    depth_before: Tensor,  # [B, 1, H, W] of the frame before, not reprojected
    normal_before: Tensor,  # [B, 3, H, W]
) -> Tensor:  # [B, 3] int64
    """Numbers of pixels:

    - whose motion ends on the screen,
    - those of them that find another surface there (`motion.same_surface`),
    - and those that show another surface than the one to their right and move as it does, within CUT_ALIKE pixels.
    """
    images = {"depth": depth, "normal": normal, "motion": motion, "depth_before": depth_before,
              "normal_before": normal_before}  # fmt: skip
    if run := FUSED(**images):
        return run(*images.values())
    seen = on_screen(motion)
    lost = seen & ~alike((depth, normal), (fetch(depth_before, motion), fetch(normal_before, motion)))
    here, right = (tuple(x[..., part] for x in (depth, normal)) for part in (slice(-1), slice(1, None)))
    apart = (motion[..., 1:] - motion[..., :-1]).square().sum(1, keepdim=True)
    beside = ~alike(here, right) & (apart < CUT_ALIKE**2)
    return torch.stack([found.sum((1, 2, 3)) for found in (seen, lost, beside)], dim=1)
