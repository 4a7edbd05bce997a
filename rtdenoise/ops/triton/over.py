"""`over_and_coverage`: along the path of the front through all kept frames, in one launch.

Few pixels are such edges: programs without any follow no path.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, FAR_AWAY, GLOSS, OVER_APART, OVER_LIGHT, OVER_SPEED, RECALL_SAME
from .common import BLOCK, grid, place
from .path import (
    beside,
    bounded,
    distance,
    end_of,
    frame_of,
    kept_at,
    kept_edge_at,
    onward,
    radiance,
    stacked,
    two,
    whole,
)


@triton.jit
def front_beside(kept, plane, at, exists, nearest, between, H, W, FAR_AWAY: tl.constexpr):
    """The motion of the front in the first pixel beside those `at` that saw it; off the screen where none did."""
    u, v = tl.where(exists, FAR_AWAY, FAR_AWAY), tl.where(exists, FAR_AWAY, FAR_AWAY)
    for k in tl.static_range(4, 0, -1):
        other = beside(at // W, at % W, k, H, W)
        _, depth = two(kept + plane + other, exists)
        other_u, other_v = two(kept + 4 * plane + other, exists)
        shows = (distance(depth) >= nearest) & (distance(depth) < between)
        u, v = tl.where(shows, other_u, u), tl.where(shows, other_v, v)
    return u, v


@triton.jit
def _over(seen, now_light, now_albedo, now_normal, motion, depth, recent, out, coverage, H, W, step, frames, words,
          apart, speed, same, light, gloss, tolerance, BLOCK: tl.constexpr, FAR_AWAY: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at = y * W + x
    seen += b * 9 * plane
    motion += b * 2 * plane
    depth += b * plane
    out += b * 9 * plane + at
    coverage += b * 3 * plane + at
    now = b * step * plane + at  # `step` channels a picture

    # The nearest and the farthest of the pixel and the four beside it.
    own = distance(tl.load(depth + at, mask=exists, other=0.0))
    near, far, front, behind = own, own, at, at
    for k in tl.static_range(1, 5):
        other_at = beside(y, x, k, H, W)
        other = distance(tl.load(depth + other_at, mask=exists, other=0.0))
        nearer, farther = other < (1 - apart) * near, (1 - apart) * other > far
        near, front = tl.where(nearer, other, near), tl.where(nearer, other_at, front)
        far, behind = tl.where(farther, other, far), tl.where(farther, other_at, behind)
    u = tl.load(motion + front, mask=exists, other=0.0)
    v = tl.load(motion + plane + front, mask=exists, other=0.0)
    du = u - tl.load(motion + behind, mask=exists, other=0.0)
    dv = v - tl.load(motion + plane + behind, mask=exists, other=0.0)
    edge = exists & (near < (1 - apart) * far) & (du * du + dv * dv > speed * speed)
    between = tl.where(far == float("inf"), 2 * near, tl.sqrt(near) * tl.sqrt(far))
    now_front = own < between

    left = tl.where(edge, 1.0, 0.0)
    fronts = tl.zeros([BLOCK], tl.float32)
    backs, s0, s1, s2, s3, s4, s5, s6, s7, s8 = (
        fronts, fronts, fronts, fronts, fronts, fronts, fronts, fronts, fronts, fronts
    )  # fmt: skip
    for j in range(tl.where(tl.max(edge.to(tl.int32), axis=0) > 0, frames, 0)):
        kept = frame_of(recent, j) + b * words * plane
        u, v = bounded(u, FAR_AWAY), bounded(v, FAR_AWAY)
        there, inside = end_of(u, v, y, x, edge, H, W)
        red, green, blue, its, nx, ny, nz, reset, more_u, more_v = kept_at(kept, plane, there, inside)
        albedo_r, albedo_g, albedo_b, _, _ = kept_edge_at(kept, plane, there, inside)
        hidden = distance(its) < (1 - tolerance) * near
        is_front = (distance(its) < between) & (hidden == 0)
        weight = tl.where(inside & (hidden == 0), left * (1 - tl.abs(u - whole(u))) * (1 - tl.abs(v - whole(v))), 0.0)
        backs += tl.where(is_front, 0.0, weight)
        weight = tl.where(is_front, weight, 0.0)
        fronts += weight
        red, green, blue = radiance(red, green, blue, albedo_r, albedo_g, albedo_b, its, gloss)
        s0 += weight * red
        s1 += weight * green
        s2 += weight * blue
        s3 += weight * albedo_r
        s4 += weight * albedo_g
        s5 += weight * albedo_b
        s6 += weight * nx
        s7 += weight * ny
        s8 += weight * nz
        left *= 1 - reset
        beside_u, beside_v = front_beside(kept, plane, there, inside, (1 - tolerance) * near, between, H, W, FAR_AWAY)
        more_u, more_v = tl.where(is_front, more_u, beside_u), tl.where(is_front, more_v, beside_v)
        u, v = onward(u, v, more_u, more_v, inside, FAR_AWAY)

    weights = 1 + fronts + backs
    for k in tl.static_range(9):
        was = tl.load(seen + k * plane + at, mask=exists, other=0.0)
        back = tl.load(seen + k * plane + behind, mask=edge, other=0.0)
        of_now = now_light if k < 3 else now_albedo if k < 6 else now_normal
        found = tl.load(of_now + now + k % 3 * plane, mask=edge & now_front, other=0.0)
        total = (s0, s1, s2, s3, s4, s5, s6, s7, s8)[k]
        total += tl.where(now_front, found, back) + tl.where(backs > 0, backs * back, 0.0)
        total = total / weights
        if k < 3:
            total = tl.where(tl.abs(total - was) <= same * was, was, total)
            total = was + light * (total - was)
        tl.store(out + k * plane, tl.where(edge, total, was), mask=exists)
    tl.store(coverage, tl.where(edge & now_front, 1.0, 0.0), mask=exists)
    tl.store(coverage + plane, fronts, mask=exists)
    tl.store(coverage + 2 * plane, fronts + backs, mask=exists)


def over_and_coverage(
    seen: Tensor, now: Sequence[Tensor], motion: Tensor, depth: Tensor, recent: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    seen, motion, depth, (B, _, H, W) = seen.contiguous(), motion.contiguous(), depth.contiguous(), seen.shape
    if [part.shape[1] for part in now] == [3, 3, 3]:
        now, step = [part.contiguous() for part in now], 3
    else:
        now, step = torch.cat(now, dim=1).contiguous().split(3, dim=1), 9
    frames, words = stacked(recent)
    out, coverage = torch.empty_like(seen), seen.new_empty(B, 3, H, W)
    _over[grid(B, H, W)](
        seen, *now, motion, depth, frames, out, coverage, H, W, step, len(recent), words, OVER_APART, OVER_SPEED,
        RECALL_SAME, OVER_LIGHT, GLOSS, DEPTH_TOLERANCE, BLOCK=BLOCK, FAR_AWAY=FAR_AWAY,
    )  # fmt: skip
    return out, coverage
