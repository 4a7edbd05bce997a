"""What the recurrent transformer (`mltd`) sees of a frame: light, distance, albedo, normal, on request positions.

Two scales are there (`MLTDConfig.normalise`): that of the frame alone, and that of the shot so far.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..color import compress
from ..frame import Frame
from ..ops.pixels import nearness


def exposed(light: Tensor, frame: Frame, exposure: Tensor, distance: Tensor, position: bool) -> list[Tensor]:
    """Light `[B, 3K, H, W]` compressed at an exposure, nearness in [0, 1), albedo and normal as they are, and positions
    about their mean in units of the mean distance."""
    places = [_about_their_mean(frame) / distance] if position else []
    return [compress(light * exposure), nearness(frame.depth, distance), frame.albedo, frame.normal, *places]


def spanned(light: Tensor, frame: Frame, before: Tensor | None, position: bool) -> tuple[list[Tensor], Tensor]:
    """Light compressed, and in units of its maximum; distances and positions between their least and greatest values;
    all of these and albedo in [-1, 1] (Chen et al. 2024, as its authors' code has it).

    `before` and the second result, `[B, 4 or 6, 1, 1]`, are the greatest values so far of each and of its negative.
    """
    values = [compress(light), frame.depth, *([torch.nan_to_num(frame.position, 0.0, 0.0, 0.0)] if position else [])]
    most = torch.cat([x.amax((1, 2, 3), keepdim=True) for value in values for x in (value, -value)], dim=1)
    if before is not None:  # a resized history holds the same numbers in several pixels
        most = torch.maximum(most, before.amax((2, 3), keepdim=True))
    scaled = []
    for i, value in enumerate(values):
        greatest, least = most[:, 2 * i : 2 * i + 1], -most[:, 2 * i + 1 : 2 * i + 2] if i else 0.0
        scaled.append(2 * (value - least) / (greatest - least).clamp(min=1e-6) - 1)
    light, depth, *places = scaled
    return [light, depth, 2 * frame.albedo - 1, frame.normal, *places], most


def _about_their_mean(frame: Frame) -> Tensor:
    """Positions of surfaces minus their mean; 0 where nothing was hit."""
    hit = frame.depth > 0
    position = torch.where(hit, torch.nan_to_num(frame.position, 0.0, 0.0, 0.0), 0.0)
    mean = position.sum((2, 3), keepdim=True) / hit.sum((2, 3), keepdim=True).clamp(min=1)
    return torch.where(hit, position - mean, 0.0)
