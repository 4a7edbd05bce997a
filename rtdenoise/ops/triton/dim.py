"""`dim`: only pixels above the usual brightness look at those around them. Equal to the plain op to the bit."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place
from .luminance import luminance


@triton.jit
def _dim(radiance, usual, out, H, W, limit, BLOCK: tl.constexpr):
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    radiance += 3 * b * plane
    out += 3 * b * plane + y * W + x
    most, brightness = tl.load(usual + b), luminance(radiance + y * W + x, plane, exists)
    bright = exists & (brightness > tl.where(most > 0, limit * most, float("inf")))
    nearest = tl.zeros([BLOCK], tl.float32)
    for k in tl.static_range(9):
        if k != 4:
            v, u = y + k // 3 - 1, x + k % 3 - 1
            inside = bright & (v >= 0) & (v < H) & (u >= 0) & (u < W)
            nearest = tl.maximum(nearest, luminance(radiance + v * W + u, plane, inside))
    bound = limit * tl.maximum(nearest, most)
    cut = bright & (brightness > bound)
    factor = tl.math.div_rn(bound, tl.where(cut, brightness, 1.0))
    for c in tl.static_range(3):
        light = tl.load(radiance + c * plane + y * W + x, mask=exists, other=0.0)
        tl.store(out + c * plane, tl.where(cut, light * factor, light), mask=exists)


def dim(radiance: Tensor, usual: Tensor, limit: float) -> Tensor:
    radiance = radiance.contiguous()
    (B, _, H, W), out = radiance.shape, torch.empty_like(radiance)
    _dim[grid(B, H, W)](radiance, usual.contiguous(), out, H, W, limit, BLOCK=BLOCK, enable_fp_fusion=False)
    return out
