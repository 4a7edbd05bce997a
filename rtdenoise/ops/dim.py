"""Single pixels that are too bright are dimmed."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import luminance
from .dispatch import Fused, Support, falls_back

SUPPORT = Support(channels={"radiance": (3,)})
FUSED = Fused("dim", native=SUPPORT, triton=SUPPORT)


@falls_back
def dim(
    radiance: Tensor,  # [B, 3, H, W] ≥ 0
    usual: Tensor,  # [B, 1] luminance of bright blocks; 0: unknown, nothing is dimmed
    limit: float,
) -> Tensor:  # [B, 3, H, W]
    """The same where luminance is within `limit` · max(brightest of the 8 neighbours, `usual`); brighter pixels get
    that luminance, and keep their hue."""
    if run := FUSED(radiance=radiance):
        return run(radiance, usual, limit)
    usual, brightness = usual.reshape(-1, 1, 1, 1), luminance(radiance)
    bound = limit * torch.maximum(_brightest_neighbour(brightness), usual)
    cut = (brightness > bound) & (usual > 0)
    return torch.where(cut, radiance * (bound / brightness), radiance)


def _brightest_neighbour(image: Tensor) -> Tensor:
    """Maximum of the 8 pixels around each, `[B, 1, H, W]`, of an image without negative values."""
    sides = F.pad(image, (1, 1, 0, 0))
    beside = torch.maximum(sides[..., :-2], sides[..., 2:])
    rows = F.pad(torch.maximum(beside, image), (0, 0, 1, 1))
    return torch.maximum(beside, torch.maximum(rows[..., :-2, :], rows[..., 2:, :]))
