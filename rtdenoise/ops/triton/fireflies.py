"""`without_fireflies`: a program has all channels of its pixels."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, FIREFLY_ALIKE, MIN_NORMAL_COSINE
from .alike import alike, surface_at
from .common import BLOCK, grid, lerp, place


@triton.jit
def _without_fireflies(light, depth, normal, known, out, H, W, depth_tolerance, normal_tolerance, LEAST: tl.constexpr,
                       BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at = y * W + x
    depth += b * plane
    normal += b * 3 * plane
    inner = exists & (y > 0) & (y < H - 1) & (x > 0) & (x < W - 1)
    d, nx, ny, nz = surface_at(depth, normal, plane, at, inner)
    same = tl.zeros([BLOCK], tl.int32)
    for k in tl.static_range(9):
        if k != 4:
            od, ox, oy, oz = surface_at(depth, normal, plane, at + (k // 3 - 1) * W + k % 3 - 1, inner)
            same += alike(d, nx, ny, nz, od, ox, oy, oz, depth_tolerance, normal_tolerance).to(tl.int32)
    firefly = inner & (same >= LEAST) & (d > 0)
    weight = tl.load(known + b * plane + at, mask=exists, other=0.0)
    for c in tl.static_range(3):
        channel = (b * 3 + c) * plane + at
        own = tl.load(light + channel, mask=exists, other=0.0)
        greatest = tl.full([BLOCK], -float("inf"), tl.float32)
        second = greatest
        for k in tl.static_range(9):
            if k != 4:
                other = tl.load(light + channel + (k // 3 - 1) * W + k % 3 - 1, mask=firefly, other=0.0)
                second = tl.maximum(second, tl.minimum(greatest, other))
                greatest = tl.maximum(greatest, other)
        tl.store(out + channel, tl.where(firefly, lerp(tl.minimum(own, second), own, weight), own), mask=exists)


def without_fireflies(light: Tensor, depth: Tensor, normal: Tensor, known: Tensor) -> Tensor:
    light, depth, normal, known = (x.contiguous() for x in (light, depth, normal, known))
    B, _, H, W = light.shape
    out = torch.empty_like(light)
    _without_fireflies[grid(B, H, W)](
        light, depth, normal, known, out, H, W, DEPTH_TOLERANCE, MIN_NORMAL_COSINE, LEAST=FIREFLY_ALIKE, BLOCK=BLOCK
    )
    return out
