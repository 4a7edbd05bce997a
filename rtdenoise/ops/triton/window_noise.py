"""`window_noise`, in one pass."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import NOISE_WINDOW, NOISE_WINDOWS
from .common import row_of

COUNT = 32  # windows of a program: few, as there are few of them, and each is much to wait for


@triton.jit
def _window_noise(radiance, depth, out, H, W, SIDE: tl.constexpr, STEP: tl.constexpr, COUNT: tl.constexpr):
    rows, columns = (H - SIDE) // STEP + 1, (W - SIDE) // STEP + 1
    b, row = row_of(rows)
    plane, column = tl.cast(H, tl.int64) * W, tl.program_id(0) * COUNT + tl.arange(0, COUNT)
    exists, corner = column < columns, row * STEP * W + column * STEP
    total = tl.zeros([COUNT], tl.float32)
    squares, hit = total, exists
    for k in tl.static_range(SIDE * SIDE):
        at = corner + k // SIDE * W + k % SIDE
        here = radiance + 3 * b * plane + at
        light = tl.load(here, mask=exists, other=0.0) + tl.load(here + plane, mask=exists, other=0.0)
        light = (light + tl.load(here + 2 * plane, mask=exists, other=0.0)) / 3
        total += light
        squares += light * light
        hit = hit & (tl.load(depth + b * plane + at, mask=exists, other=0.0) > 0)
    mean, square = total / (SIDE * SIDE), squares / (SIDE * SIDE)
    relative = tl.maximum(square / tl.maximum(mean * mean, 1e-30) - 1, 0.0) * (SIDE * SIDE) / (SIDE * SIDE - 1)
    noise = tl.where(hit & (mean > 0), relative, float("nan"))
    tl.store(out + (b * rows + row) * columns + column, noise, mask=exists)


def window_noise(radiance: Tensor, depth: Tensor) -> Tensor:
    radiance, depth, (B, _, H, W) = radiance.contiguous(), depth.contiguous(), radiance.shape
    rows, columns = ((n - NOISE_WINDOW) // NOISE_WINDOWS + 1 for n in (H, W))
    out, constants = radiance.new_empty(B, rows * columns), {"SIDE": NOISE_WINDOW, "STEP": NOISE_WINDOWS}
    _window_noise[triton.cdiv(columns, COUNT), B * rows](
        radiance, depth, out, H, W, COUNT=COUNT, num_warps=1, **constants
    )
    return out
