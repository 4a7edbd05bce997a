"""`keep`: a frame in words of two bfloat16, with the motion of its edges."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, RECALL_EDGE_SPEED, RECALL_FOOTPRINT_WORDS, RECALL_WORDS
from .common import BLOCK, grid, place
from .path import edge_motion


@triton.jit
def _half(x):
    """The bits of bfloat16: the nearest, even in between."""
    bits = x.to(tl.uint32, bitcast=True)
    return tl.where(x == x, (bits + 0x7FFF + ((bits >> 16) & 1)) >> 16, 0x7FC0)


@triton.jit
def _store(kept, low, high, exists):
    tl.store(kept, (_half(low) | (_half(high) << 16)).to(tl.int32, bitcast=True), mask=exists)


@triton.jit
def _keep(light, depth, normal, reset, motion, albedo, kept, H, W, depth_tolerance, edge_speed, WORDS: tl.constexpr,
          FOOTPRINT: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at = y * W + x
    light += b * 3 * plane + at
    normal += b * 3 * plane + at
    motion += b * 2 * plane
    depth += b * plane
    kept += b * WORDS * plane + at
    red = tl.load(light, mask=exists, other=0.0)
    green = tl.load(light + plane, mask=exists, other=0.0)
    _store(kept, red, green, exists)
    blue = tl.load(light + 2 * plane, mask=exists, other=0.0)
    _store(kept + plane, blue, tl.load(depth + at, mask=exists, other=0.0), exists)
    nx, ny = tl.load(normal, mask=exists, other=0.0), tl.load(normal + plane, mask=exists, other=0.0)
    _store(kept + 2 * plane, nx, ny, exists)
    nz = tl.load(normal + 2 * plane, mask=exists, other=0.0)
    _store(kept + 3 * plane, nz, tl.load(reset + b * plane + at, mask=exists, other=0.0), exists)
    u = tl.load(motion + at, mask=exists, other=0.0)
    v = tl.load(motion + plane + at, mask=exists, other=0.0)
    _store(kept + 4 * plane, u, v, exists)
    if FOOTPRINT:
        albedo += b * 3 * plane + at
        red = tl.load(albedo, mask=exists, other=0.0)
        green = tl.load(albedo + plane, mask=exists, other=0.0)
        blue = tl.load(albedo + 2 * plane, mask=exists, other=0.0)
        u, v, _ = edge_motion(motion, depth, plane, y, x, exists, H, W, depth_tolerance, edge_speed)
        _store(kept + 5 * plane, red, green, exists)
        _store(kept + 6 * plane, blue, u, exists)
        _store(kept + 7 * plane, v, tl.zeros([BLOCK], tl.float32), exists)


def keep(light: Tensor, depth: Tensor, normal: Tensor, reset: Tensor, motion: Tensor, albedo: Tensor | None) -> Tensor:
    images = [t.contiguous() for t in (light, depth, normal, reset, motion, light if albedo is None else albedo)]
    B, _, H, W = light.shape
    words = RECALL_WORDS if albedo is None else RECALL_FOOTPRINT_WORDS
    kept = torch.empty(B, words, H, W, dtype=torch.int32, device=light.device)
    constants = {"WORDS": words, "FOOTPRINT": albedo is not None, "BLOCK": BLOCK}
    _keep[grid(B, H, W)](*images, kept, H, W, DEPTH_TOLERANCE, RECALL_EDGE_SPEED, **constants)
    return kept
