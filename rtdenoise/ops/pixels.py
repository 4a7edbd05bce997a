"""Ops in which every pixel stands alone: albedo divided out and multiplied back, running means, nearness, limits."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..color import albedo_divisor
from .blend import blend
from .dispatch import Fused, Support, falls_back

OF_DEMODULATE = Support(max_channels=8, channels={"albedo": (0,), "depth": (1,)})
OF_MODULATE = Support(max_channels=8, channels={"albedo": (0,), "mean_albedo": (0,), "sharp": (1,), "depth": (1,)})
OF_ACCUMULATE = Support(max_channels=9, channels={"length": (1,), "reset": (1,)})
DEMODULATE = Fused("pixels.demodulate", native=OF_DEMODULATE, triton=OF_DEMODULATE)
MODULATE = Fused("pixels.modulate", native=OF_MODULATE, triton=OF_MODULATE)
ACCUMULATE = Fused("pixels.accumulate", native=OF_ACCUMULATE, triton=OF_ACCUMULATE)
NEARNESS = Fused("pixels.nearness", native=Support(), triton=Support())
OF_JOINED = Support(max_channels=9, channels={"n": (1,), "b": (0,), "m": (1,)})
JOINED = Fused("pixels.joined", native=OF_JOINED, triton=OF_JOINED)
WITHIN = Fused("pixels.within", native=Support())


@falls_back
def demodulate(
    radiance: Tensor,  # [B, 3, H, W]
    albedo: Tensor,  # [B, 3, H, W]
    depth: Tensor,  # [B, 1, H, W], 0 where nothing was hit
) -> Tensor:  # [B, 3, H, W]
    """Radiance over `color.albedo_divisor`: irradiance, where the surface is diffuse. Inverse: `modulate`."""
    if run := DEMODULATE(radiance=radiance, albedo=albedo, depth=depth):
        return run(radiance, albedo, depth)
    return radiance / albedo_divisor(albedo, depth)


@falls_back
def modulate(
    irradiance: Tensor,  # [B, 3, H, W]; negative values count as 0
    albedo: Tensor,  # [B, 3, H, W] of this frame
    mean_albedo: Tensor,  # [B, 3, H, W] the running mean over frames
    sharp: Tensor,  # [B, 1, H, W] in [0, 1]: weight of `albedo` against `mean_albedo`
    depth: Tensor,  # [B, 1, H, W], 0 where nothing was hit
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """Irradiance times `color.albedo_divisor` of the blended albedo: radiance again. Inverse of `demodulate`."""
    if run := MODULATE(irradiance=irradiance, albedo=albedo, mean_albedo=mean_albedo, sharp=sharp, depth=depth):
        return run(irradiance, albedo, mean_albedo, sharp, depth)
    return irradiance.clamp(min=0) * albedo_divisor(blend(albedo, mean_albedo, sharp), depth)


@falls_back
def accumulate(
    new: Tensor | Sequence[Tensor],  # [B, C, H, W]; several are joined along channels
    mean: Tensor,  # [B, C, H, W] of the frames before
    length: Tensor,  # [B, 1, H, W] number of those frames
    reset: Tensor,  # [B, 1, H, W] in [0, 1]: share of the mean that the new frame replaces; 1 restarts it
    max_length: float,
    same: float = 0.0,
) -> tuple[Tensor, Tensor]:  # [B, C, H, W], [B, 1, H, W]
    """A running mean and its length, updated with one frame:

    w = 1 / (1 + length),  a = w + reset · (1 - w),  mean' = a · new + (1 - a) · mean,  length' = min(1/a, max_length)

    Values of the mean that differ from the new ones by the share `same` or less count as these: they have been rounded.

    Raises ValueError where the channels do not fit.
    """
    new = [new] if isinstance(new, Tensor) else [*new]
    if sum(part.shape[1] for part in new) != mean.shape[1]:
        raise ValueError(f"expected {mean.shape[1]} channels, got {[part.shape[1] for part in new]}")
    if run := ACCUMULATE(new=new, mean=mean, length=length, reset=reset):
        return run(new, mean, length, reset, max_length, same)
    new = torch.cat(new, dim=1) if len(new) > 1 else new[0]
    weight = 1 / (1 + length)
    weight = weight + reset * (1 - weight)
    mean = torch.where((mean - new).abs() <= same * new.abs(), new, mean)
    return blend(new, mean, weight), (1 / weight).clamp(max=max_length)


@falls_back
def joined(
    a: Tensor,  # [B, C, H, W] a mean
    n: Tensor,  # [B, 1, H, W] of so many frames
    b: Tensor,  # [B, C, H, W] another mean
    m: Tensor,  # [B, 1, H, W] of so many
) -> tuple[Tensor, Tensor]:  # [B, C, H, W], [B, 1, H, W]
    """Both means as one, and the frames in it; where there are none, `a`."""
    if run := JOINED(a=a, n=n, b=b, m=m):
        return run(a, n, b, m)
    total = n + m
    return torch.lerp(a, b, m / total.clamp(min=1e-6)), total


@falls_back
def nearness(
    depth: Tensor,  # [B, 1, H, W], 0 where nothing was hit
    distance: Tensor,  # [B, 1, 1, 1] > 0: the frame's mean distance (`ops.mean_distance`)
) -> Tensor:  # [B, 1, H, W] in [0, 1)
    """Depth as a network sees it: distance / (distance + depth); 0 where nothing was hit."""
    if run := NEARNESS(depth=depth):
        return run(depth, distance)
    return torch.where(depth > 0, distance / (distance + depth), 0.0)


@falls_back
def within(values: Tensor, low: float, high: float) -> bool:
    """Whether all values, `[B, C, H, W]`, are in [low, high], both float32 numbers. NaN is outside."""
    if run := WITHIN(values=values):
        return run(values, low, high)
    if values.numel() == 0:
        return True
    least, greatest = values.aminmax()  # both are NaN if any value is
    return bool((least >= low) & (greatest <= high))
