"""What history is fetched with: `warp`, `fetch` and `reproject`."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import constants, grid, place


@triton.jit
def _target(motion, x, n):
    """Clamped target of pixel x of n, a motion that is not finite counting as none."""
    finite = tl.abs(motion) <= 3.4028235e38
    return tl.minimum(tl.maximum(tl.where(finite, motion, 0.0) + x, 0.0), n - 1.0)


@triton.jit
def _catmull_rom(f, TAP: tl.constexpr):
    """The weight of pixel x0 - 1 + TAP for a target f beyond x0."""
    if TAP == 0:
        weight = f * (f * (1 - 0.5 * f) - 0.5)
    elif TAP == 1:
        weight = 1 + f * f * (1.5 * f - 2.5)
    elif TAP == 2:
        weight = f * (0.5 + f * (2 - 1.5 * f))
    else:
        weight = f * f * (0.5 * f - 0.5)
    return weight


@triton.jit
def _warp(image, motion, out, H, W, C: tl.constexpr, CP: tl.constexpr, MODE: tl.constexpr, BLOCK: tl.constexpr):
    """`MODE` nearest, bilinear or cubic."""
    b, y, x, exists = place(H, W, BLOCK)
    plane = H.to(tl.int64) * W
    c = tl.arange(0, CP)
    pixel = y * W + x
    u = _target(tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0), x, W)
    v = _target(tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0), y, H)
    channels = b * C * plane + c[None, :] * plane
    real = exists[:, None] & (c[None, :] < C)
    from_ = image + channels
    x0, y0 = u.to(tl.int32), v.to(tl.int32)
    f, g = (u - x0)[:, None], (v - y0)[:, None]
    if MODE == "nearest":
        at = (v + 0.5).to(tl.int32) * W + (u + 0.5).to(tl.int32)
        result = tl.load(from_ + at[:, None], mask=real, other=0.0)
    elif MODE == "bilinear":
        x1, y1 = tl.minimum(x0 + 1, W - 1), tl.minimum(y0 + 1, H - 1)
        top = tl.load(from_ + (y0 * W + x0)[:, None], mask=real, other=0.0) * (1 - f)
        top += tl.load(from_ + (y0 * W + x1)[:, None], mask=real, other=0.0) * f
        bottom = tl.load(from_ + (y1 * W + x0)[:, None], mask=real, other=0.0) * (1 - f)
        bottom += tl.load(from_ + (y1 * W + x1)[:, None], mask=real, other=0.0) * f
        result = top * (1 - g) + bottom * g
    else:
        least = tl.load(from_ + (y0 * W + x0)[:, None], mask=real, other=0.0)
        greatest = least
        result = tl.zeros([BLOCK, CP], tl.float32)
        for j in tl.static_range(4):
            line = tl.zeros([BLOCK, CP], tl.float32)
            row = tl.minimum(tl.maximum(y0 + j - 1, 0), H - 1) * W
            for i in tl.static_range(4):
                at = row + tl.minimum(tl.maximum(x0 + i - 1, 0), W - 1)
                tap = tl.load(from_ + at[:, None], mask=real, other=0.0)
                line += tap * _catmull_rom(f, i)
                if (i % 3 != 0) and (j % 3 != 0):
                    least, greatest = tl.minimum(least, tap), tl.maximum(greatest, tap)
            result += line * _catmull_rom(g, j)
        result = tl.minimum(tl.maximum(result, least), greatest)
    tl.store(out + channels + pixel[:, None], result, mask=real)


def warp(
    image: Tensor, motion: Tensor, seen: Tensor | None = None, otherwise: Tensor | None = None, cubic: bool = False
) -> Tensor:
    found = _look_up(image, motion, "cubic" if cubic else "bilinear")
    return found if seen is None else torch.where(seen, found, otherwise)


def fetch(image: Tensor, motion: Tensor) -> Tensor:
    return _look_up(image, motion, "nearest")


def _look_up(image: Tensor, motion: Tensor, mode: str) -> Tensor:
    image, motion = image.contiguous(), motion.contiguous()
    out, (B, C, H, W) = torch.empty_like(image), image.shape
    _warp[grid(B, H, W)](image, motion, out, H, W, **constants(C), MODE=mode)
    return out


@triton.jit
def _reproject(stored, motion, depth, normal, depth_before, normal_before, out, valid, H, W, depth_tolerance,
               normal_tolerance, least, C: tl.constexpr, CP: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = H.to(tl.int64) * W
    c = tl.arange(0, CP)
    pixel = y * W + x
    channels = b * C * plane + c[None, :] * plane
    mx = tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0)
    my = tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0)
    u = tl.where(mx != mx, 1e6, tl.minimum(tl.maximum(mx, -1e6), 1e6)) + x
    v = tl.where(my != my, 1e6, tl.minimum(tl.maximum(my, -1e6), 1e6)) + y
    left, top = tl.floor(u), tl.floor(v)
    f, g = u - left, v - top
    d = tl.load(depth + b * plane + pixel, mask=exists, other=0.0)
    nx = tl.load(normal + b * 3 * plane + pixel, mask=exists, other=0.0)
    ny = tl.load(normal + (b * 3 + 1) * plane + pixel, mask=exists, other=0.0)
    nz = tl.load(normal + (b * 3 + 2) * plane + pixel, mask=exists, other=0.0)
    total = tl.zeros([BLOCK], tl.float32)
    found = tl.zeros([BLOCK, CP], tl.float32)
    for tap in tl.static_range(4):
        i, j = top.to(tl.int32) + tap // 2, left.to(tl.int32) + tap % 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        at = i * W + j
        wd = tl.load(depth_before + b * plane + at, mask=inside, other=0.0)
        wx = tl.load(normal_before + b * 3 * plane + at, mask=inside, other=0.0)
        wy = tl.load(normal_before + (b * 3 + 1) * plane + at, mask=inside, other=0.0)
        wz = tl.load(normal_before + (b * 3 + 2) * plane + at, mask=inside, other=0.0)
        length = tl.sqrt((nx * nx + ny * ny + nz * nz) * (wx * wx + wy * wy + wz * wz))
        near = tl.abs(d - wd) <= depth_tolerance * tl.maximum(d, wd)
        aligned = nx * wx + ny * wy + nz * wz >= normal_tolerance * length
        hit, was_hit = d > 0, wd > 0
        same = inside & ((hit & was_hit & near & aligned) | (~hit & ~was_hit))
        across = f if tap % 2 else 1 - f
        weight = tl.where(same, across * (g if tap // 2 else 1 - g), 0.0)
        total += weight
        values = tl.load(stored + channels + at[:, None], mask=inside[:, None] & (c[None, :] < C), other=0.0)
        found += weight[:, None] * values
    enough = total >= least
    scale = tl.where(enough, 1 / tl.maximum(total, least), 0.0)
    real = exists[:, None] & (c[None, :] < C)
    tl.store(out + channels + pixel[:, None], found * scale[:, None], mask=real)
    tl.store(valid + b * plane + pixel, enough.to(tl.uint8), mask=exists)


def reproject(
    stored: list[Tensor], motion: Tensor, *geometry: Tensor, tolerances: tuple[float, float], least: float
) -> tuple[Tensor, Tensor]:
    """`geometry` is depth, normal, depth and normal of the previous frame."""
    stored, motion, *geometry = (t.contiguous() for t in (torch.cat(stored, dim=1), motion, *geometry))
    B, C, H, W = stored.shape
    out, valid = torch.empty_like(stored), torch.empty(B, 1, H, W, dtype=torch.uint8, device=stored.device)
    _reproject[grid(B, H, W)](stored, motion, *geometry, out, valid, H, W, *tolerances, least, **constants(C))
    return out, valid.view(torch.bool)
