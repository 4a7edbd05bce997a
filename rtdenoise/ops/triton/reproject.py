"""`reproject`, without gradients."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import FAR_AWAY, MIN_HISTORY_WEIGHT
from .alike import alike, surface_at
from .common import constants, grid, place


@triton.jit
def _bounded(motion, FAR_AWAY: tl.constexpr):
    return tl.where(motion != motion, FAR_AWAY, tl.minimum(tl.maximum(motion, -FAR_AWAY), FAR_AWAY))


@triton.jit
def _reproject(stored, motion, depth, normal, depth_before, normal_before, out, valid, H, W, depth_tolerance,
               normal_tolerance, C: tl.constexpr, CP: tl.constexpr, BLOCK: tl.constexpr, MIN_HISTORY_WEIGHT:
               tl.constexpr, FAR_AWAY: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    c = tl.arange(0, CP)
    pixel = y * W + x
    channels = b * C * plane + c[None, :] * plane
    u = _bounded(tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0), FAR_AWAY) + x
    v = _bounded(tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0), FAR_AWAY) + y
    left, top = tl.floor(u), tl.floor(v)
    f, g = u - left, v - top
    d, nx, ny, nz = surface_at(depth + b * plane, normal + b * 3 * plane, plane, pixel, exists)
    total = tl.zeros([BLOCK], tl.float32)
    found = tl.zeros([BLOCK, CP], tl.float32)
    for tap in tl.static_range(4):
        i, j = top.to(tl.int32) + tap // 2, left.to(tl.int32) + tap % 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        at = i * W + j
        wd, wx, wy, wz = surface_at(depth_before + b * plane, normal_before + b * 3 * plane, plane, at, inside)
        same = inside & alike(d, nx, ny, nz, wd, wx, wy, wz, depth_tolerance, normal_tolerance)
        across = f if tap % 2 else 1 - f
        weight = tl.where(same, across * (g if tap // 2 else 1 - g), 0.0)
        total += weight
        values = tl.load(stored + channels + at[:, None], mask=inside[:, None] & (c[None, :] < C), other=0.0)
        found += weight[:, None] * values
    enough = total >= MIN_HISTORY_WEIGHT
    scale = tl.where(enough, 1 / tl.maximum(total, MIN_HISTORY_WEIGHT), 0.0)
    real = exists[:, None] & (c[None, :] < C)
    tl.store(out + channels + pixel[:, None], found * scale[:, None], mask=real)
    tl.store(valid + b * plane + pixel, enough.to(tl.uint8), mask=exists)


def reproject(
    stored: list[Tensor], motion: Tensor, *geometry: Tensor, tolerances: tuple[float, float]
) -> tuple[Tensor, Tensor]:
    """`geometry` is depth and normal, then those of the previous frame; `tolerances` is that of depth, then of
    normals."""
    stored, motion, *geometry = (t.contiguous() for t in (torch.cat(stored, dim=1), motion, *geometry))
    B, C, H, W = stored.shape
    out, valid = torch.empty_like(stored), torch.empty(B, 1, H, W, dtype=torch.uint8, device=stored.device)
    limits = {"MIN_HISTORY_WEIGHT": MIN_HISTORY_WEIGHT, "FAR_AWAY": FAR_AWAY}
    _reproject[grid(B, H, W)](stored, motion, *geometry, out, valid, H, W, *tolerances, **constants(C), **limits)
    return out, valid.view(torch.bool)
