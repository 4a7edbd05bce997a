"""Light averaged over the frames before and over those after: joined, and as two witnesses against a picture."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..color import albedo_divisor
from ..frame import Frame
from ..models.shrinkage import SHARE_OF_FRAMES, edges, few_samples, weight
from ..models.window import box
from ..ops.pixels import demodulate

SIDE = 13  # pixels, odd: of the neighbourhood in which both sides must agree


@dataclass(frozen=True)
class Estimate:
    """One pass's knowledge of a frame."""

    image: Tensor  # [1, 3, H, W] the denoised frame
    mean: Tensor  # [1, 3, H, W] irradiance averaged over time
    mean_albedo: Tensor  # [1, 3, H, W] likewise
    length: Tensor  # [1, 1, H, W] frames in these means
    first: bool  # whether the pass begins a shot here: the image is that of the frame alone


def two_sided(frame: Frame, forward: Estimate, backward: Estimate) -> Tensor:
    """Radiance `[1, 3, H, W]`, averaged over the frames before and after.

    With n frames in the forward mean m and n' in the backward mean m', which share the frame itself, y:
    (n m + n' m' - y) / (n + n' - 1), of light over albedo; then multiplied by the averaged albedo.
    """
    noisy = demodulate(frame.radiance, frame.albedo, frame.depth)
    count = forward.length + backward.length - 1

    def joined(before: Tensor, after: Tensor, now: Tensor) -> Tensor:
        return ((forward.length * before + backward.length * after - now) / count).clamp(min=0)

    light = joined(forward.mean, backward.mean, noisy)
    albedo = joined(forward.mean_albedo, backward.mean_albedo, frame.albedo)
    return light * albedo_divisor(albedo, frame.depth)


def corrected(frame: Frame, image: Tensor, forward: Estimate, backward: Estimate) -> Tensor:
    """`image` `[1, 3, H, W]` with the light back that it lost, as far as past and future agree on it.

    The past, with the frame itself, and the future are two means with independent noise, of n and n' frames. Their
    residuals a and b against the image are its error and noise; `models.shrinkage` tells them apart:

        E = mean a b,    V = mean (a - b)² n n' / (n + n')²,    image + w (n a + n' b) / (n + n')

    So a shadow comes back that no feature shows and that stays where it is. One that moves lags behind in opposite
    directions on both sides: a b is negative, and nothing is corrected.
    """
    divisor = albedo_divisor(frame.albedo, frame.depth)
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
