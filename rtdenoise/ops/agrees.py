"""How far a frame agrees with a running mean of light, for all that its noise hides."""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import AGREES_PATIENCE, RECALL_ROUNDING
from .dispatch import Fused, Support, falls_back
from .recall import unchanged

SUPPORT = Support(max_channels=3, channels={"light": (3,), "mean": (3,), "found": (1,)}, bytes=("found",))
FUSED = Fused("agrees", native=SUPPORT, triton=SUPPORT)


@falls_back
def agrees(
    light: Tensor,  # [B, 3, H, W] of the frame
    mean: Tensor,  # [B, 3, H, W] of frames before, at its pixels
    found: Tensor,  # [B, 1, H, W] bool: where there is a mean
) -> Tensor:  # [B, 1, H, W] in [0, 1]
    """The factor u of `recall`, from the differences d = mean - light where there is a mean, with bounds
    AGREES_PATIENCE times as high. Without roots: that of a mean is greater than the mean of roots; so light is squared
    in what is added for rounding, too. No gradients.

    Raises ValueError where the shapes do not fit.
    """
    check_before(light, mean, found)
    if run := FUSED(light=light, mean=mean, found=found.view(torch.uint8)):
        return run(light, mean, found)
    least = RECALL_ROUNDING * light.square().sum(1, keepdim=True)
    return unchanged(found * (mean - light), found * least, AGREES_PATIENCE)


def check_before(image: Tensor, before: Tensor, found: Tensor) -> None:
    """Raise ValueError unless these are two images `[B, 3, H, W]`, of now and before, and where there is any of before,
    `[B, 1, H, W]`."""
    B, C, H, W = image.shape
    if C != 3 or before.shape != image.shape or found.shape != (B, 1, H, W):
        raise ValueError(f"expected two images [B, 3, H, W] and found {(B, 1, H, W)}, got {tuple(image.shape)}, "
                         f"{tuple(before.shape)} and {tuple(found.shape)}")  # fmt: skip
