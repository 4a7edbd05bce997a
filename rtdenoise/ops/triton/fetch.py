"""`fetch`, without gradients."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place
from .targets import clamped_target


@triton.jit
def _fetch(image, motion, out, H, W, C: tl.constexpr, BLOCK: tl.constexpr):
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    pixel = y * W + x
    u = clamped_target(tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0), x, W)
    v = clamped_target(tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0), y, H)
    at = (v + 0.5).to(tl.int32) * W + (u + 0.5).to(tl.int32)
    for c in range(C):
        channel = (b * C + c) * plane
        tl.store(out + channel + pixel, tl.load(image + channel + at, mask=exists, other=0.0), mask=exists)


def fetch(image: Tensor, motion: Tensor) -> Tensor:
    image, motion = image.contiguous(), motion.contiguous()
    out, (B, C, H, W) = torch.empty_like(image), image.shape
    _fetch[grid(B, H, W)](image, motion, out, H, W, C=C, BLOCK=BLOCK)
    return out
