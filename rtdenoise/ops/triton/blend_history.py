"""`blend_history`: the temporal kernel, over gaps that are filled as they are read, and the blend."""

from __future__ import annotations

import math

import torch
import triton
import triton.language as tl
from torch import Tensor

from ..logits import strides
from .common import BLOCK, grid, lerp, place
from .logits import greatest, offset


@triton.jit
def _blend_history(spatial, past, seen, logits, alpha, out, H, W, batch, stride, cell_row, row, cell, step,
                   K: tl.constexpr, C: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    """Three channels at a time, each in a tile of its own: a tile of all would be moved between threads at every tap,
    whose weights lie by pixels."""
    b, y, x, exists = place(H, W, BLOCK)
    plane, stride = tl.cast(H, tl.int64) * W, tl.cast(stride, tl.int64)
    logits += b * batch + offset(y, x, cell_row, row, cell, step)
    seen += b * plane
    alpha += b * plane
    here = y * W + x
    most = greatest(logits, y, x, exists, H, W, stride, K)
    weight = tl.load(alpha + here, mask=exists, other=0.0)
    for c in tl.static_range(0, C, 3):
        first = b * C * plane + c * plane
        total = tl.zeros([BLOCK], tl.float32)
        red, green, blue = total, total, total
        for k in tl.static_range(K * K):
            i, j = y + k // K - K // 2, x + k % K - K // 2
            inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
            w = tl.exp(tl.load(logits + k * stride, mask=inside, other=-float("inf")).to(tl.float32) - most)
            total += w
            at = i * W + j
            known = tl.load(seen + at, mask=inside, other=0) != 0
            source = tl.where(known, past + first + at, spatial + first + at)
            red += w * tl.load(source, mask=inside, other=0.0)
            if c + 1 < C:
                green += w * tl.load(source + plane, mask=inside, other=0.0)
            if c + 2 < C:
                blue += w * tl.load(source + 2 * plane, mask=inside, other=0.0)
        total = tl.where(exists, total, 1.0)
        spatial_at, at = spatial + first + here, out + first + here
        tl.store(at, lerp(red / total, tl.load(spatial_at, mask=exists, other=0.0), weight), mask=exists)
        if c + 1 < C:
            now = tl.load(spatial_at + plane, mask=exists, other=0.0)
            tl.store(at + plane, lerp(green / total, now, weight), mask=exists)
        if c + 2 < C:
            now = tl.load(spatial_at + 2 * plane, mask=exists, other=0.0)
            tl.store(at + 2 * plane, lerp(blue / total, now, weight), mask=exists)


def blend_history(spatial: Tensor, past: Tensor, seen: Tensor, logits: Tensor, alpha: Tensor) -> Tensor:
    spatial, past, seen, alpha = (t.contiguous() for t in (spatial, past, seen.view(torch.uint8), alpha))
    B, C, H, W = past.shape
    out, K = torch.empty_like(past), math.isqrt(logits.shape[-3])
    constants = {"K": K, "C": C, "BLOCK": BLOCK}
    _blend_history[grid(B, H, W)](spatial, past, seen, logits, alpha, out, H, W, *strides(logits), **constants)
    return out
