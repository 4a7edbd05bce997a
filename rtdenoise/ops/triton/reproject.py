"""`reproject`, without gradients."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import FAR_AWAY, MIN_HISTORY_WEIGHT
from .alike import alike, surface_at
from .common import BLOCK, grid, place
from .path import bounded


@triton.jit
def _tap(TAP: tl.constexpr, u, v, depth_before, normal_before, plane, d, nx, ny, nz, exists, H, W, depth_tolerance,
         normal_tolerance):  # fmt: skip
    """The bilinear weight of one of the four pixels around a target, if it shows the same surface; its place, -1 where
    it has no weight."""
    left, top = tl.floor(u), tl.floor(v)
    f, g = u - left, v - top
    i, j = top.to(tl.int32) + TAP // 2, left.to(tl.int32) + TAP % 2
    inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
    at = i * W + j
    wd, wx, wy, wz = surface_at(depth_before, normal_before, plane, at, inside)
    same = inside & alike(d, nx, ny, nz, wd, wx, wy, wz, depth_tolerance, normal_tolerance)
    weight = (f if TAP % 2 else 1 - f) * (g if TAP // 2 else 1 - g)
    return tl.where(same, weight, 0.0), tl.where(same & (weight > 0), at, -1)


@triton.jit
def _reproject(stored, motion, depth, normal, depth_before, normal_before, out, valid, H, W, depth_tolerance,
               normal_tolerance, COUNTS: tl.constexpr, TOTAL: tl.constexpr, BLOCK: tl.constexpr, MIN_HISTORY_WEIGHT:
               tl.constexpr, FAR_AWAY: tl.constexpr):  # fmt: skip
    """`stored`: images of COUNTS channels, TOTAL together."""
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    pixel = y * W + x
    u = bounded(tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0), FAR_AWAY) + x
    v = bounded(tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0), FAR_AWAY) + y
    d, nx, ny, nz = surface_at(depth + b * plane, normal + b * 3 * plane, plane, pixel, exists)
    depth_before += b * plane
    normal_before += b * 3 * plane
    w0, at0 = _tap(0, u, v, depth_before, normal_before, plane, d, nx, ny, nz, exists, H, W, depth_tolerance,
                   normal_tolerance)  # fmt: skip
    w1, at1 = _tap(1, u, v, depth_before, normal_before, plane, d, nx, ny, nz, exists, H, W, depth_tolerance,
                   normal_tolerance)  # fmt: skip
    w2, at2 = _tap(2, u, v, depth_before, normal_before, plane, d, nx, ny, nz, exists, H, W, depth_tolerance,
                   normal_tolerance)  # fmt: skip
    w3, at3 = _tap(3, u, v, depth_before, normal_before, plane, d, nx, ny, nz, exists, H, W, depth_tolerance,
                   normal_tolerance)  # fmt: skip
    total = w0 + w1 + w2 + w3
    enough = total >= MIN_HISTORY_WEIGHT
    scale = 1 / tl.maximum(total, MIN_HISTORY_WEIGHT)
    out += b * TOTAL * plane + pixel
    for n in tl.static_range(len(stored)):
        for c in range(COUNTS[n]):
            source = stored[n] + (b * COUNTS[n] + c) * plane
            found = w0 * tl.load(source + at0, mask=at0 >= 0, other=0.0)
            found += w1 * tl.load(source + at1, mask=at1 >= 0, other=0.0)
            found += w2 * tl.load(source + at2, mask=at2 >= 0, other=0.0)
            found += w3 * tl.load(source + at3, mask=at3 >= 0, other=0.0)
            tl.store(out, tl.where(enough, found * scale, 0.0), mask=exists)
            out += plane
    tl.store(valid + b * plane + pixel, enough.to(tl.uint8), mask=exists)


def reproject(
    stored: list[Tensor], motion: Tensor, *geometry: Tensor, tolerances: tuple[float, float]
) -> tuple[Tensor, Tensor]:
    """`geometry` is depth and normal, then those of the previous frame; `tolerances` is that of depth, then of
    normals."""
    motion, *geometry = (t.contiguous() for t in (motion, *geometry))
    B, _, H, W = motion.shape
    counts = tuple(image.shape[1] for image in stored)
    out, valid = motion.new_empty(B, sum(counts), H, W), motion.new_empty(B, 1, H, W, dtype=torch.uint8)
    _reproject[grid(B, H, W)](
        tuple(image.contiguous() for image in stored), motion, *geometry, out, valid, H, W, *tolerances, COUNTS=counts,
        TOTAL=sum(counts), BLOCK=BLOCK, MIN_HISTORY_WEIGHT=MIN_HISTORY_WEIGHT, FAR_AWAY=FAR_AWAY,
    )  # fmt: skip
    return out, valid.view(torch.bool)
