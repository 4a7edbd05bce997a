"""`downsample`: one plane after the other."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place
from .pool import pooled


@triton.jit
def _downsample(image, out, H, W, MAXIMUM: tl.constexpr, BLOCK: tl.constexpr):
    h, w = (H + 1) // 2, (W + 1) // 2
    n, y, x, exists = place(h, w, BLOCK)
    value = pooled(image + n * H * W, y, x, exists, H, W, MAXIMUM)
    tl.store(out + n * h * w + y * w + x, value, mask=exists)


def downsample(image: Tensor, pool: str) -> Tensor:
    image = image.contiguous()
    B, C, H, W = image.shape
    h, w = (H + 1) // 2, (W + 1) // 2
    out = image.new_empty(B, C, h, w)
    _downsample[grid(B * C, h, w)](image, out, H, W, MAXIMUM=pool == "max", BLOCK=BLOCK)
    return out
