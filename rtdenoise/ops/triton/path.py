"""Paths back through kept frames, for `recall` and `over`: `ops.kept.Path`.

A kernel follows a path through all kept frames, as each step depends on the one before alone. It takes the frames as
`FRAMES` pointers or more, so that it is compiled once, not for every number of frames (`stacked`). In a recorded step
the pointers may lead to addresses of frames (`ops.elsewhere`).
"""

from __future__ import annotations

from collections.abc import Sequence

import triton
import triton.language as tl
from torch import Tensor

from ..elsewhere import Elsewhere
from .common import within

FRAMES = 8


def stacked(recent: Sequence[Tensor]) -> tuple[tuple[Tensor, ...], int]:
    """Kept frames as kernels take them, and how many words each pixel of one has. Frames of a history that another
    network began may have more than the others."""
    words = min(kept.shape[1] for kept in recent)
    if all(isinstance(kept, Elsewhere) and kept.shape[1] == words for kept in recent):
        frames = [kept.address for kept in recent]
    else:
        frames = [kept[:, :words].contiguous() for kept in recent]
    room = max(FRAMES, triton.next_power_of_2(len(frames)))
    return (*frames, *frames[:1] * (room - len(frames))), words


@triton.jit
def frame_of(frames, j):
    """The pointer to kept frame j, which is no constant. `frames`: pointers to frames, or to their addresses."""
    address = frames[0].to(tl.int64)
    for k in tl.static_range(1, len(frames)):
        address = tl.where(j == k, frames[k].to(tl.int64), address)
    if frames[0].dtype.element_ty == tl.int64:
        address = tl.load(address.to(tl.pointer_type(tl.int64)))
    return address.to(tl.pointer_type(tl.int32))


@triton.jit
def bounded(motion, FAR_AWAY: tl.constexpr):
    """A motion that a whole number can hold; one that is no number leads far away."""
    return tl.where(motion != motion, FAR_AWAY, tl.minimum(tl.maximum(motion, -FAR_AWAY), FAR_AWAY))


@triton.jit
def whole(motion):
    """The nearest whole number to a bounded motion, even in between."""
    return (motion + 12582912.0) - 12582912.0  # 1.5 · 2²³: the sum is rounded to a whole number


@triton.jit
def two(words, exists):
    """Both bfloat16 of each word, the lower one first."""
    word = tl.load(words, mask=exists, other=0)
    return (word << 16).to(tl.float32, bitcast=True), (word & -65536).to(tl.float32, bitcast=True)


@triton.jit
def end_of(u, v, y, x, exists, H, W):
    """Where a bounded motion leads to in the kept frame, and whether that is on the screen."""
    i, j = whole(v).to(tl.int32) + y, whole(u).to(tl.int32) + x
    return i * W + j, exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)


@triton.jit
def kept_at(kept, plane, at, exists):
    """Light, depth, normal, reset and motion of the pixels `at` of a kept frame."""
    red, green = two(kept + at, exists)
    blue, depth = two(kept + plane + at, exists)
    x, y = two(kept + 2 * plane + at, exists)
    z, reset = two(kept + 3 * plane + at, exists)
    u, v = two(kept + 4 * plane + at, exists)
    return red, green, blue, depth, x, y, z, reset, u, v


@triton.jit
def kept_edge_at(kept, plane, at, exists):
    """Albedo, and the motion of the edge, of those with footprints."""
    red, green = two(kept + 5 * plane + at, exists)
    blue, u = two(kept + 6 * plane + at, exists)
    v, _ = two(kept + 7 * plane + at, exists)
    return red, green, blue, u, v


@triton.jit
def radiance(red, green, blue, albedo_r, albedo_g, albedo_b, depth, gloss):
    """Light on a surface as it is seen: times its colour, where anything was hit."""
    hit = depth > 0
    return (
        tl.where(hit, red * (albedo_r + gloss), red),
        tl.where(hit, green * (albedo_g + gloss), green),
        tl.where(hit, blue * (albedo_b + gloss), blue),
    )


@triton.jit
def onward(u, v, more_u, more_v, inside, FAR_AWAY: tl.constexpr):
    """A path that goes on by what was found, or ends off the screen."""
    return tl.where(inside, u + more_u, FAR_AWAY), tl.where(inside, v + more_v, FAR_AWAY)


@triton.jit
def distance(depth):
    """Depth, but infinite where nothing was hit."""
    return tl.where(depth > 0, depth, float("inf"))


@triton.jit
def beside(y, x, k: tl.constexpr, H, W):
    """Pixel k of a pixel and the four beside it (`ops.recall.BESIDE`); borders are repeated."""
    v = y + (-1 if k == 1 else 1 if k == 4 else 0)
    u = x + (-1 if k == 2 else 1 if k == 3 else 0)
    return within(v, H) * W + within(u, W)


@triton.jit
def edge_motion(motion, depth, plane, y, x, exists, H, W, depth_tolerance, edge_speed):
    """`ops.kept.edge_motion` of one image: (x, y), and the distance of what has it."""
    at = y * W + x
    own_u = tl.load(motion + at, mask=exists, other=0.0)
    own_v = tl.load(motion + plane + at, mask=exists, other=0.0)
    own = distance(tl.load(depth + at, mask=exists, other=0.0))
    nearest, place = own, at
    for k in tl.static_range(1, 5):
        other_at = beside(y, x, k, H, W)
        other = distance(tl.load(depth + other_at, mask=exists, other=0.0))
        nearer = other < (1 - depth_tolerance) * nearest
        nearest, place = tl.where(nearer, other, nearest), tl.where(nearer, other_at, place)
    u = tl.load(motion + place, mask=exists, other=0.0)
    v = tl.load(motion + plane + place, mask=exists, other=0.0)
    slow = (u - own_u) * (u - own_u) + (v - own_v) * (v - own_v) <= edge_speed * edge_speed
    return tl.where(slow, u, own_u), tl.where(slow, v, own_v), tl.where(slow, nearest, own)
