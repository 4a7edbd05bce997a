"""Paths back through kept frames, for `recall` and `over`: `ops.recall.Path`."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def bounded(motion, FAR_AWAY: tl.constexpr):
    """A motion that a whole number can hold; one that is no number leads far away."""
    return tl.where(motion != motion, FAR_AWAY, tl.minimum(tl.maximum(motion, -FAR_AWAY), FAR_AWAY))


@triton.jit
def whole(motion):
    """The nearest whole number to a bounded motion, even in between."""
    return (motion + 12582912.0) - 12582912.0  # 1.5 · 2²³: the sum is rounded to a whole number


@triton.jit
def two(kept, at, exists):
    """Both bfloat16 of the words `at`, the lower one first."""
    word = tl.load(kept + at, mask=exists, other=0)
    return (word << 16).to(tl.float32, bitcast=True), (word & -65536).to(tl.float32, bitcast=True)


@triton.jit
def end_of(u, v, y, x, exists, H, W):
    """Where a bounded motion leads to in the kept frame, and whether that is on the screen."""
    i, j = whole(v).to(tl.int32) + y, whole(u).to(tl.int32) + x
    return i * W + j, exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)


@triton.jit
def kept_at(kept, plane, at, exists):
    """Light, depth, normal, reset and motion of the pixels `at` of a kept frame."""
    red, green = two(kept, at, exists)
    blue, depth = two(kept + plane, at, exists)
    x, y = two(kept + 2 * plane, at, exists)
    z, reset = two(kept + 3 * plane, at, exists)
    u, v = two(kept + 4 * plane, at, exists)
    return red, green, blue, depth, x, y, z, reset, u, v


@triton.jit
def kept_edge_at(kept, plane, at, exists):
    """Albedo, and the motion of the edge, of those with footprints."""
    red, green = two(kept + 5 * plane, at, exists)
    blue, u = two(kept + 6 * plane, at, exists)
    v, _ = two(kept + 7 * plane, at, exists)
    return red, green, blue, u, v


@triton.jit
def distance(depth):
    """Depth, but infinite where nothing was hit."""
    return tl.where(depth > 0, depth, float("inf"))


@triton.jit
def beside(y, x, k: tl.constexpr, H, W):
    """Pixel k of a pixel and the four beside it (`ops.recall.BESIDE`); borders are repeated."""
    v = y + (-1 if k == 1 else 1 if k == 4 else 0)
    u = x + (-1 if k == 2 else 1 if k == 3 else 0)
    return tl.minimum(tl.maximum(v, 0), H - 1) * W + tl.minimum(tl.maximum(u, 0), W - 1)
