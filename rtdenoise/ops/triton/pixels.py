"""Ops in which every pixel stands alone: one pass each."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import GLOSS
from .common import FLAT, flat_grid, lerp, of_images, place_flat


@triton.jit
def _demodulate(radiance, albedo, depth, out, plane, gloss, C: tl.constexpr, BLOCK: tl.constexpr):
    b, at, exists = place_flat(plane, BLOCK)
    hit = tl.load(depth + b * plane + at, mask=exists, other=0.0) > 0
    at += b * C * plane
    for _ in tl.static_range(C):
        a = tl.load(albedo + at, mask=exists, other=0.0)
        light = tl.load(radiance + at, mask=exists, other=0.0)
        tl.store(out + at, light / tl.where(hit, a + gloss, 1.0), mask=exists)
        at += plane


@triton.jit
def _modulate(irradiance, albedo, mean_albedo, sharp, depth, out, plane, gloss, C: tl.constexpr, BLOCK: tl.constexpr):
    b, at, exists = place_flat(plane, BLOCK)
    hit = tl.load(depth + b * plane + at, mask=exists, other=0.0) > 0
    weight = tl.load(sharp + b * plane + at, mask=exists, other=0.0)
    at += b * C * plane
    for _ in tl.static_range(C):
        light = tl.load(irradiance + at, mask=exists, other=0.0)
        a = tl.load(albedo + at, mask=exists, other=0.0)
        mean = tl.load(mean_albedo + at, mask=exists, other=0.0)
        divisor = tl.where(hit, lerp(mean, a, weight) + gloss, 1.0)
        tl.store(out + at, tl.where(light < 0, 0.0, light) * divisor, mask=exists)
        at += plane


@triton.jit
def _accumulate(first, second, third, mean, length, reset, out, next_length, plane, most, same, M: tl.constexpr,
                N: tl.constexpr, C: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    """M channels of `first`, then those of `second` up to the N-th, then those of `third`, C in all."""
    b, at, exists = place_flat(plane, BLOCK)
    weight = 1 / (1 + tl.load(length + b * plane + at, mask=exists, other=0.0))
    weight += tl.load(reset + b * plane + at, mask=exists, other=0.0) * (1 - weight)
    frames = 1 / weight
    tl.store(next_length + b * plane + at, tl.where(frames > most, most, frames), mask=exists)
    for c in tl.static_range(C):
        if c < M:
            new = tl.load(first + (b * M + c) * plane + at, mask=exists, other=0.0)
        elif c < N:
            new = tl.load(second + (b * (N - M) + c - M) * plane + at, mask=exists, other=0.0)
        else:
            new = tl.load(third + (b * (C - N) + c - N) * plane + at, mask=exists, other=0.0)
        before = tl.load(mean + (b * C + c) * plane + at, mask=exists, other=0.0)
        before = tl.where(tl.abs(before - new) <= same * tl.abs(new), new, before)
        tl.store(out + (b * C + c) * plane + at, lerp(before, new, weight), mask=exists)


@triton.jit
def _joined(a, n, b, m, out, total, plane, C: tl.constexpr, BLOCK: tl.constexpr):
    image, at, exists = place_flat(plane, BLOCK)
    of_b = tl.load(m + image * plane + at, mask=exists, other=0.0)
    both = tl.load(n + image * plane + at, mask=exists, other=0.0) + of_b
    tl.store(total + image * plane + at, both, mask=exists)
    at += image * C * plane
    for _ in tl.static_range(C):
        mean = tl.load(a + at, mask=exists, other=0.0)
        other = tl.load(b + at, mask=exists, other=0.0)
        tl.store(out + at, lerp(mean, other, of_b / tl.maximum(both, 1e-6)), mask=exists)
        at += plane


@triton.jit
def _nearness(depth, distance, out, plane, BLOCK: tl.constexpr):
    b, at, exists = place_flat(plane, BLOCK)
    d = tl.load(depth + b * plane + at, mask=exists, other=0.0)
    mean = tl.load(distance + b)
    tl.store(out + b * plane + at, tl.where(d > 0, mean / (mean + d), 0.0), mask=exists)


def demodulate(radiance: Tensor, albedo: Tensor, depth: Tensor) -> Tensor:
    return _each_pixel(_demodulate, radiance, albedo, depth)


def modulate(irradiance: Tensor, albedo: Tensor, mean_albedo: Tensor, sharp: Tensor, depth: Tensor) -> Tensor:
    return _each_pixel(_modulate, irradiance, albedo, mean_albedo, sharp, depth)


def accumulate(
    new: Sequence[Tensor], mean: Tensor, length: Tensor, reset: Tensor, max_length: float, same: float
) -> tuple[Tensor, Tensor]:
    if len(new) > 3:
        new = [torch.cat([*new], dim=1)]
    new, inputs = [t.contiguous() for t in new], [t.contiguous() for t in (mean, length, reset)]
    out, next_length = torch.empty_like(inputs[0]), torch.empty_like(inputs[1])
    B, C, H, W = mean.shape
    M, N = new[0].shape[1], sum(t.shape[1] for t in new[:2])
    new += new[:1] * (3 - len(new))  # not read
    sizes = {"M": M, "N": N, "C": C, "BLOCK": FLAT}
    _accumulate[flat_grid(B, H * W)](*new, *inputs, out, next_length, H * W, float(max_length), same, **sizes)
    return out, next_length


def joined(a: Tensor, n: Tensor, b: Tensor, m: Tensor) -> tuple[Tensor, Tensor]:
    a, n, b, m = (t.contiguous() for t in (a, n, b, m))
    out, total = torch.empty_like(a), torch.empty_like(n)
    B, C, H, W = a.shape
    _joined[flat_grid(B, H * W)](a, n, b, m, out, total, H * W, C=C, BLOCK=FLAT)
    return out, total


def nearness(depth: Tensor, distance: Tensor) -> Tensor:
    depth = depth.contiguous()
    B, C, H, W = depth.shape
    out = torch.empty_like(depth)
    _nearness[flat_grid(B, C * H * W)](depth, of_images(distance, B), out, C * H * W, BLOCK=FLAT)
    return out


def _each_pixel(kernel, *inputs: Tensor) -> Tensor:
    inputs = [t.contiguous() for t in inputs]
    out = torch.empty_like(inputs[0])
    B, C, H, W = out.shape
    kernel[flat_grid(B, H * W)](*inputs, out, H * W, GLOSS, C=C, BLOCK=FLAT)
    return out
