"""Keep a frame for `ops.recall`: its light, surfaces and motion, two bfloat16 in each integer."""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import FAR_AWAY
from .dispatch import Fused, Support, falls_back
from .kept import edge_motion

LAYERS = {"light": (3,), "depth": (1,), "normal": (3,), "reset": (1,), "motion": (2,), "albedo": (3,)}
FUSED = Fused("keep", native=Support(channels=LAYERS), triton=Support(channels=LAYERS))


@falls_back
def keep(
    light: Tensor,  # [B, 3, H, W]
    depth: Tensor,  # [B, 1, H, W]
    normal: Tensor,  # [B, 3, H, W]
    reset: Tensor,  # [B, 1, H, W] in [0, 1]: how far light gave way to this frame's; older frames count so much less
    motion: Tensor | None,  # [B, 2, H, W] (x, y) in pixels; paths end at a frame without
    albedo: Tensor | None = None,  # [B, 3, H, W] for footprints
) -> Tensor:  # [B, 5, H, W] int32; 8 channels with albedo
    """A frame as `recall` takes it: two bfloat16 in each integer, the first in its lower half. Compiled code keeps them
    together for each pixel (channels last)."""
    if motion is None:
        motion = torch.full_like(light[:, :2], FAR_AWAY)
    if run := FUSED(light=light, depth=depth, normal=normal, reset=reset, motion=motion, albedo=albedo):
        return run(light, depth, normal, reset, motion, albedo)
    more = [] if albedo is None else [albedo, edge_motion(motion, depth)[0], torch.zeros_like(depth)]
    halves = torch.cat([light, depth, normal, reset, motion, *more], dim=1).bfloat16()
    return torch.stack([halves[:, 0::2], halves[:, 1::2]], dim=-1).view(torch.int32)[..., 0]
