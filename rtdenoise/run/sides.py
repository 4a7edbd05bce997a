"""What was seen in the frames before and in those after, joined."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..frame import Frame
from ..models.footprint import footprint_of
from ..ops.recall import FOOTPRINT

COUNTED = [0] * FOOTPRINT[0] + [1] * sum(FOOTPRINT[1:])  # which of both counts of an estimate a footprint's channel has


@dataclass(frozen=True)
class Estimate:
    """One pass's knowledge of a frame."""

    image: Tensor  # [1, 3, H, W] the denoised frame
    first: bool  # whether the pass begins a shot here: the image is that of the frame alone
    footprint: Tensor  # [1, 9, H, W] `covered.as_covered`
    footprint_count: Tensor  # [1, 1, H, W] frames in its radiance
    surface_count: Tensor  # [1, 1, H, W] frames in its albedo and normal
    trusted: Tensor  # [1, 1, H, W] `History.trusted`


def seen_on_both_sides(frame: Frame, forward: Estimate, backward: Estimate) -> tuple[Tensor, Tensor, Tensor]:
    """Footprints of both passes as one, `[1, 9, H, W]`, and the number of frames in its radiance and in its albedo and
    normal, `[1, 1, H, W]` ≥ 1 each.

    With n frames in the forward mean f and n' in the backward mean f', which share the frame itself, y:
    (n f + n' f' - y) / (n + n' - 1). At edges that move (`covered`) that is nearly so: where the frame sees what is
    behind, f has the mean of that instead of y.
    """
    now = torch.cat(footprint_of(frame), dim=1)
    counts = [torch.cat([e.footprint_count, e.surface_count], dim=1) for e in (forward, backward)]
    total = sum(n[:, COUNTED] * e.footprint for n, e in zip(counts, (forward, backward), strict=True)) - now
    count = sum(counts) - 1
    colours, normal = (total / count[:, COUNTED]).split([6, 3], dim=1)
    return torch.cat([colours.clamp(min=0), normal], dim=1), *count.split(1, dim=1)
