"""The blend of the filtered frame with filtered history."""

from __future__ import annotations

import torch
from torch import Tensor


def blend(
    spatial: Tensor,  # [B, C, H, W] the filtered current frame
    temporal: Tensor,  # [B, C, H, W] the filtered, reprojected previous output
    alpha: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """`out = α · spatial + (1 - α) · temporal`: the paper's eq. 1, with α learned per pixel."""
    return torch.lerp(temporal, spatial, alpha)
