"""`compressed`: both pictures at once, blurred or not. The mean is torch's reduction."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import SHIFT_BRIGHTNESS
from .common import BLOCK, grid, place, within
from .luminance import luminance

ROWS = 8  # of a program that blurs: the rows above and below are computed once more


@triton.jit
def _row(picture, y, x, exists, H, W, scale, BLURRED: tl.constexpr):
    """log(1 + s x) in row y, or its sum over three columns. Borders are repeated."""
    plane = tl.cast(H, tl.int64) * W
    line = picture + within(y, H) * W
    if BLURRED:
        total = tl.zeros(x.shape, tl.float32)
        for k in tl.static_range(3):
            at = within(x + (k - 1), W)
            total += tl.log(luminance(line + at, plane, exists) * scale + 1)
    else:
        total = tl.log(luminance(line + x, plane, exists) * scale + 1)
    return total


@triton.jit
def _compressed(now, before, means, out, B, H, W, brightness, BLURRED: tl.constexpr, ROWS: tl.constexpr,
                BLOCK: tl.constexpr):  # fmt: skip
    """ROWS rows of both pictures. `means`: of the first one's red, green and blue."""
    b, top, x, exists = place(tl.cdiv(H, ROWS), W, BLOCK)
    top *= ROWS
    plane = tl.cast(H, tl.int64) * W
    mean = luminance(means + 3 * b, 1, True)
    scale = brightness / tl.maximum(mean, 1e-12, propagate_nan=tl.PropagateNan.ALL)
    for k in tl.static_range(2):
        picture = (now if k == 0 else before) + b * 3 * plane
        target = out + (k * tl.cast(B, tl.int64) + b) * plane + x
        if BLURRED:
            above = _row(picture, top - 1, x, exists, H, W, scale, BLURRED)
            here = _row(picture, top, x, exists, H, W, scale, BLURRED)
            for i in range(ROWS):
                y = top + i
                inside = exists & (y < H)
                below = _row(picture, y + 1, x, inside, H, W, scale, BLURRED)
                tl.store(target + y * W, (above + here + below) / 9, mask=inside)
                above, here = here, below
        else:
            for i in range(ROWS):
                y = top + i
                inside = exists & (y < H)
                value = _row(picture, y, x, inside, H, W, scale, BLURRED)
                tl.store(target + y * W, value, mask=inside)


def compressed(now: Tensor, before: Tensor, blurred: bool) -> tuple[Tensor, Tensor]:
    now, before = now.contiguous(), before.contiguous()
    B, _, H, W = now.shape
    out, rows = now.new_empty(2, B, 1, H, W), ROWS if blurred else 1
    _compressed[grid(B, triton.cdiv(H, rows), W)](
        now, before, now.mean((2, 3)), out, B, H, W, SHIFT_BRIGHTNESS, BLURRED=blurred, ROWS=rows, BLOCK=BLOCK
    )
    return out[0], out[1]
