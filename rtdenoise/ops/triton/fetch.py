"""`fetch`, without gradients."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import constants, grid, place
from .targets import clamped_target


@triton.jit
def _fetch(image, motion, out, H, W, C: tl.constexpr, CP: tl.constexpr, BLOCK: tl.constexpr):
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    c = tl.arange(0, CP)
    pixel = y * W + x
    u = clamped_target(tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0), x, W)
    v = clamped_target(tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0), y, H)
    channels = b * C * plane + c[None, :] * plane
    real = exists[:, None] & (c[None, :] < C)
    at = (v + 0.5).to(tl.int32) * W + (u + 0.5).to(tl.int32)
    tl.store(out + channels + pixel[:, None], tl.load(image + channels + at[:, None], mask=real, other=0.0), mask=real)


def fetch(image: Tensor, motion: Tensor) -> Tensor:
    image, motion = image.contiguous(), motion.contiguous()
    out, (B, C, H, W) = torch.empty_like(image), image.shape
    _fetch[grid(B, H, W)](image, motion, out, H, W, **constants(C))
    return out
