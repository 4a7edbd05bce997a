"""What was seen in the frames before and in those after: joined, and as two witnesses against a picture."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..color import albedo_divisor
from ..frame import Frame
from ..models.past import footprint_of
from ..models.shrinkage import SHARE_OF_FRAMES, edges, few_samples, weight
from ..models.window import box
from ..ops.pixels import demodulate
from ..ops.recall import FOOTPRINT

COUNTED = [0] * FOOTPRINT[0] + [1] * sum(FOOTPRINT[1:])  # which of both counts of an estimate a footprint's channel has
SIDE = 13  # pixels, odd: of the neighbourhood in which both sides must agree


@dataclass(frozen=True)
class Estimate:
    """One pass's knowledge of a frame."""

    image: Tensor  # [1, 3, H, W] the denoised frame
    mean: Tensor  # [1, 3, H, W] irradiance averaged over time
    length: Tensor  # [1, 1, H, W] frames in this mean
    first: bool  # whether the pass begins a shot here: the image is that of the frame alone
    footprint: Tensor  # [1, 9, H, W] `covered.as_covered`
    footprint_count: Tensor  # [1, 1, H, W] frames in its radiance
    surface_count: Tensor  # [1, 1, H, W] frames in its albedo and normal


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


def corrected(frame: Frame, image: Tensor, forward: Estimate, backward: Estimate) -> Tensor:
    """`image` `[1, 3, H, W]` with the light back that it lost, as far as past and future agree on it.

    The past, with the frame itself, and the future are two means with independent noise, of n and n' frames. Their
    residuals a and b against the image are its error and noise; `models.shrinkage` tells them apart:

        E = mean a b,    V = mean (a - b)² n n' / (n + n')²,    image + w (n a + n' b) / (n + n')

    So a shadow comes back that no feature shows and that stays where it is. One that moves lags behind in opposite
    directions on both sides: a b is negative, and nothing is corrected. Light becomes radiance by the albedo that both
    sides have seen: the frame's own is noise in a texture, on which both would agree.
    """
    _, albedo, _ = seen_on_both_sides(frame, forward, backward)[0].split(FOOTPRINT, dim=1)
    divisor = albedo_divisor(albedo, frame.depth)
    before, after = forward.length, backward.length - 1
    future = backward.length * backward.mean - demodulate(frame.radiance, frame.albedo, frame.depth)
    a, b = forward.mean * divisor - image, future / after.clamp(min=1) * divisor - image
    usable = (after >= 1) & ~(edges(frame) & few_samples(frame))

    usable = usable.to(image.dtype)
    share, count = box(usable, SIDE).clamp(min=1e-6), before + after
    spread = (a - b).square() * (before * after / count.square())
    error, variance = (box(usable * x.mean(1, keepdim=True), SIDE) / share for x in (a * b, spread))
    change = weight(error, variance, SHARE_OF_FRAMES) * usable * (before * a + after * b) / count
    return torch.maximum(image + change, image.clamp(max=0))
