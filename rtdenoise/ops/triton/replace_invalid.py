"""`replace_invalid`, one launch for all layers: a program has some pixels of each."""

from __future__ import annotations

from collections.abc import Mapping

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...frame import OFF_SCREEN

LAYERS = "radiance", "components", "albedo", "normal", "depth", "motion", "motion_next"
PIXELS = 512  # of a program
LARGEST = tl.constexpr(3.4028234663852886e38)  # finite float32


@triton.jit
def _clamped(layer, out, pixel, N, low, high, C: tl.constexpr):
    """C channels; what is not finite becomes 0."""
    plane, exists = tl.cast(N, tl.int64), pixel < N
    at = tl.program_id(1) * C * plane + pixel
    for c in tl.static_range(C):
        value = tl.load(layer + at + c * plane, mask=exists, other=0.0)
        value = tl.where(tl.abs(value) <= LARGEST, value, 0.0)
        value = tl.where(value < low, low, tl.where(value > high, high, value))
        tl.store(out + at + c * plane, value, mask=exists)


@triton.jit
def _chosen(layer, out, pixel, N, low, high, otherwise, C: tl.constexpr):
    """C channels; what is not above `low` and at most `high` is replaced."""
    plane, exists = tl.cast(N, tl.int64), pixel < N
    at = tl.program_id(1) * C * plane + pixel
    for c in tl.static_range(C):
        value = tl.load(layer + at + c * plane, mask=exists, other=0.0)
        tl.store(out + at + c * plane, tl.where((value > low) & (value <= high), value, otherwise), mask=exists)


@triton.jit
def _replace(radiance, components, albedo, normal, depth, motion, motion_next, valid_radiance, valid_components,
             valid_albedo, valid_normal, valid_depth, valid_motion, valid_motion_next, N, darkest, brightest,
             least_albedo, greatest_albedo, least_normal, greatest_normal, far, off_screen, RADIANCE: tl.constexpr,
             COMPONENTS: tl.constexpr, ALBEDO: tl.constexpr, NORMAL: tl.constexpr, DEPTH: tl.constexpr,
             MOTION: tl.constexpr, MOTION_NEXT: tl.constexpr, PIXELS: tl.constexpr):  # fmt: skip
    pixel = tl.program_id(0) * PIXELS + tl.arange(0, PIXELS)
    _clamped(radiance, valid_radiance, pixel, N, darkest, brightest, RADIANCE)
    _clamped(components, valid_components, pixel, N, darkest, brightest, COMPONENTS)
    _clamped(albedo, valid_albedo, pixel, N, least_albedo, greatest_albedo, ALBEDO)
    _clamped(normal, valid_normal, pixel, N, least_normal, greatest_normal, NORMAL)
    _chosen(depth, valid_depth, pixel, N, 0.0, far, 0.0, DEPTH)
    _chosen(motion, valid_motion, pixel, N, -float("inf"), LARGEST, off_screen, MOTION)
    _chosen(motion_next, valid_motion_next, pixel, N, -float("inf"), LARGEST, off_screen, MOTION_NEXT)


def replace_invalid(layers: Mapping[str, Tensor], limits: Mapping[str, tuple[float, float]]) -> dict[str, Tensor]:
    layers = {name: tensor.contiguous() for name, tensor in layers.items()}
    valid = {name: torch.empty_like(tensor) for name, tensor in layers.items()}
    any_layer = next(iter(layers.values()))
    B, _, H, W = any_layer.shape
    pointers = [tensors.get(name, any_layer) for tensors in (layers, valid) for name in LAYERS]
    channels = {name.upper(): layers[name].shape[1] if name in layers else 0 for name in LAYERS}
    bounds = *limits["radiance"], *limits["albedo"], *limits["normal"], limits["depth"][1], OFF_SCREEN
    _replace[triton.cdiv(H * W, PIXELS), B](*pointers, H * W, *bounds, PIXELS=PIXELS, **channels)
    return valid
