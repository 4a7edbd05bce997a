"""The test for one surface: may two pixels show the same one?"""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import DEPTH_TOLERANCE, MIN_NORMAL_COSINE


def alike(
    surface: tuple[Tensor, Tensor],  # depth [B, 1, H, W] and normal [B, 3, H, W] at each pixel
    other: tuple[Tensor, Tensor],  # the same of the surface it is compared with
    depth_tolerance: float = DEPTH_TOLERANCE,
    normal_tolerance: float = MIN_NORMAL_COSINE,
) -> Tensor:  # [B, 1, H, W] bool
    """Whether two pixels may show the same surface:

        |depth - other| ≤ depth_tolerance · max(depth, other)   and   cos(normal, other) ≥ normal_tolerance

    Two misses (depth 0) are alike; a hit and a miss are not. Normals of any length will do: at edges they are means
    over the pixel. A normal of length 0 passes.
    """
    (depth, normal), (other_depth, other_normal) = surface, other
    near = (depth - other_depth).abs() <= depth_tolerance * torch.maximum(depth, other_depth)
    lengths = (normal.square().sum(1, keepdim=True) * other_normal.square().sum(1, keepdim=True)).sqrt()
    aligned = (normal * other_normal).sum(1, keepdim=True) >= normal_tolerance * lengths
    hit, other_hit = depth > 0, other_depth > 0
    return torch.where(hit & other_hit, near & aligned, hit == other_hit)
