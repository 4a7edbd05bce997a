"""What is done to each pixel by itself: textures taken out and given back, running means, nearness, shares."""

from __future__ import annotations

import torch
from torch import Tensor

from ..color import albedo_divisor
from .layout import whole
from .path import fused
from .pyramid import blend


def demodulate(
    radiance: Tensor,  # [B, 3, H, W]
    albedo: Tensor,  # [B, 3, H, W]
    depth: Tensor,  # [B, 1, H, W], 0 where nothing was hit
) -> Tensor:  # [B, 3, H, W]
    """Irradiance, but for what is not diffuse: radiance over `color.albedo_divisor`. Inverse: `modulate`."""
    if run := fused("demodulate", radiance, albedo, depth):
        return run(radiance, albedo, depth)
    return radiance / albedo_divisor(albedo, depth)


def modulate(
    irradiance: Tensor,  # [B, 3, H, W]; what is negative counts as 0
    albedo: Tensor,  # [B, 3, H, W] of this frame
    mean_albedo: Tensor,  # [B, 3, H, W] and over frames
    sharp: Tensor,  # [B, 1, H, W] in [0, 1]: weight of the first against the second
    depth: Tensor,  # [B, 1, H, W]
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """Radiance again: the texture that `demodulate` took out is given back."""
    if run := fused("modulate", irradiance, albedo, mean_albedo, sharp, depth):
        return run(irradiance, albedo, mean_albedo, sharp, depth)
    return irradiance.clamp(min=0) * albedo_divisor(blend(albedo, mean_albedo, sharp), depth)


def accumulate(
    new: Tensor,  # [B, C, H, W]
    mean: Tensor,  # [B, C, H, W] of the frames before
    length: Tensor,  # [B, 1, H, W] how many they are
    reset: Tensor,  # [B, 1, H, W] in [0, 1]: how far the mean is given up for the new frame
    longest: float,  # what the length is at most
) -> tuple[Tensor, Tensor]:  # [B, C, H, W], [B, 1, H, W]
    """A running mean and its length, one frame on:

    w = 1 / (1 + length),  a = w + reset · (1 - w),  mean' = a · new + (1 - a) · mean,  length' = min(1/a, longest)
    """
    if run := fused("accumulate", new, mean, length, reset):
        return run(new, mean, length, reset, longest)
    weight = 1 / (1 + length)
    weight = weight + reset * (1 - weight)
    return blend(new, mean, weight), (1 / weight).clamp(max=longest)


def within(values: Tensor, low: float, high: float) -> bool:
    """Whether all values, `[B, C, H, W]`, are in [low, high], both float32 numbers. NaN is not."""
    if run := fused("within", values):
        return run(values, low, high)
    if values.numel() == 0:
        return True
    least, greatest = values.aminmax()  # of NaN both are NaN
    return bool((least >= low) & (greatest <= high))


def nearness(
    depth: Tensor,  # [B, 1, H, W], 0 where nothing was hit
    distance: Tensor,  # [B, 1, 1, 1] > 0: the frame's mean (`frame.mean_distance`)
) -> Tensor:  # [B, 1, H, W] in [0, 1)
    """Depth as a network sees it: t / (t + depth) with t the mean distance; 0 where nothing was hit."""
    if run := fused("nearness", depth):
        return run(depth, distance)
    return torch.where(depth > 0, distance / (distance + depth), 0.0)


def shares(
    logits: Tensor,  # [B, 2, 2, N, ⌈H/2⌉, ⌈W/2⌉] by cells, in any dtype (`apply_kernel`)
    size: tuple[int, int],  # (H, W)
) -> Tensor:  # [B, N, H, W] float32 in [0, 1]
    """What a head says of each pixel, by cells, as a sigmoid: how much of one thing is taken and not of another."""
    if run := fused("shares", logits):
        return run(logits, size)
    return whole(logits)[:, :, : size[0], : size[1]].float().sigmoid()
