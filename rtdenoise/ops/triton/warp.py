"""`warp`, without gradients."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place, within
from .targets import clamped_target


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
def _warp(image, motion, seen, otherwise, out, H, W, C: tl.constexpr, CUBIC: tl.constexpr, CHOICE: tl.constexpr,
          BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    pixel = y * W + x
    u = clamped_target(tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0), x, W)
    v = clamped_target(tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0), y, H)
    x0, y0 = u.to(tl.int32), v.to(tl.int32)
    f, g = u - x0, v - y0
    looked = exists
    if CHOICE:
        looked = tl.load(seen + b * plane + pixel, mask=exists, other=0) != 0
    for c in tl.static_range(C):
        here = (b * C + c) * plane
        source = image + here
        if CUBIC:
            least = tl.load(source + y0 * W + x0, mask=looked, other=0.0)
            greatest = least
            result = tl.zeros([BLOCK], tl.float32)
            for j in tl.static_range(4):
                line = tl.zeros([BLOCK], tl.float32)
                row = within(y0 + j - 1, H) * W
                for i in tl.static_range(4):
                    at = row + within(x0 + i - 1, W)
                    tap = tl.load(source + at, mask=looked, other=0.0)
                    line += tap * _catmull_rom(f, i)
                    if (i % 3 != 0) and (j % 3 != 0):
                        least, greatest = tl.minimum(least, tap), tl.maximum(greatest, tap)
                result += line * _catmull_rom(g, j)
            result = tl.where(result < least, least, tl.where(result > greatest, greatest, result))  # NaN stays
        else:
            x1, y1 = tl.minimum(x0 + 1, W - 1), tl.minimum(y0 + 1, H - 1)
            top = tl.load(source + y0 * W + x0, mask=looked, other=0.0) * (1 - f)
            top += tl.load(source + y0 * W + x1, mask=looked, other=0.0) * f
            bottom = tl.load(source + y1 * W + x0, mask=looked, other=0.0) * (1 - f)
            bottom += tl.load(source + y1 * W + x1, mask=looked, other=0.0) * f
            result = top * (1 - g) + bottom * g
        if CHOICE:
            other = tl.load(otherwise + here + pixel, mask=exists & ~looked, other=0.0)
            result = tl.where(looked, result, other)
        tl.store(out + here + pixel, result, mask=exists)


def warp(
    image: Tensor, motion: Tensor, seen: Tensor | None = None, otherwise: Tensor | None = None, cubic: bool = False
) -> Tensor:
    image, motion = image.contiguous(), motion.contiguous()
    out, (B, C, H, W) = torch.empty_like(image), image.shape
    # Without a choice these are not read.
    choice = (image, image) if seen is None else (seen.contiguous().view(torch.uint8), otherwise.contiguous())
    constants = {"C": C, "CUBIC": cubic, "CHOICE": seen is not None, "BLOCK": BLOCK}
    _warp[grid(B, H, W)](image, motion, *choice, out, H, W, **constants)
    return out
