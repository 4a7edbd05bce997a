"""`over_and_coverage`: one kept frame after the other along the path of the front."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import FAR_AWAY, GLOSS, OVER_APART, OVER_LIGHT, OVER_SAME, OVER_SPEED
from .common import BLOCK, grid, place
from .path import beside, bounded, distance, end_of, kept_at, kept_edge_at, whole


@triton.jit
def _over(seen, now, motion, depth, kept, path, out, coverage, H, W, words, apart, speed, same, light, gloss,
          FIRST: tl.constexpr, LAST: tl.constexpr, BLOCK: tl.constexpr, FAR_AWAY: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at = y * W + x
    seen += b * 9 * plane
    motion += b * 2 * plane
    path += b * 6 * plane + at  # motion (x, y), share left, weights, motion onward (x, y)
    out += b * 9 * plane + at
    coverage += b * 3 * plane + at

    # The nearest and the farthest of the pixel and the four beside it.
    own = distance(tl.load(depth + b * plane + at, mask=exists, other=0.0))
    near, far, front, behind = own, own, at, at
    for k in tl.static_range(1, 5):
        other_at = beside(y, x, k, H, W)
        other = distance(tl.load(depth + b * plane + other_at, mask=exists, other=0.0))
        nearer, farther = other < (1 - apart) * near, (1 - apart) * other > far
        near, front = tl.where(nearer, other, near), tl.where(nearer, other_at, front)
        far, behind = tl.where(farther, other, far), tl.where(farther, other_at, behind)
    front_u = tl.load(motion + front, mask=exists, other=0.0)
    front_v = tl.load(motion + plane + front, mask=exists, other=0.0)
    du = front_u - tl.load(motion + behind, mask=exists, other=0.0)
    dv = front_v - tl.load(motion + plane + behind, mask=exists, other=0.0)
    edge = exists & (near < (1 - apart) * far) & (du * du + dv * dv > speed * speed)
    between = tl.where(far == float("inf"), 2 * near, tl.sqrt(near) * tl.sqrt(far))
    now_front = own < between

    if FIRST:
        onward_u, onward_v = front_u, front_v
        u, v = front_u, front_v
        left = tl.where(exists, 1.0, 0.0)
        weights, fronts = left, 0.0 * left
    else:
        u, v = tl.load(path, mask=edge, other=0.0), tl.load(path + plane, mask=edge, other=0.0)
        left = tl.load(path + 2 * plane, mask=edge, other=0.0)
        weights = tl.load(path + 3 * plane, mask=edge, other=1.0)
        onward_u = tl.load(path + 4 * plane, mask=edge, other=0.0)
        onward_v = tl.load(path + 5 * plane, mask=edge, other=0.0)
        fronts = tl.load(coverage + plane, mask=edge, other=0.0)
    u, v = bounded(u, FAR_AWAY), bounded(v, FAR_AWAY)
    there, inside = end_of(u, v, y, x, edge, H, W)
    kept += b * words * plane
    red, green, blue, its, nx, ny, nz, reset, on_u, on_v = kept_at(kept, plane, there, inside)
    albedo_r, albedo_g, albedo_b, _, _ = kept_edge_at(kept, plane, there, inside)
    is_front = distance(its) < between
    weight = tl.where(inside, left * (1 - tl.abs(u - whole(u))) * (1 - tl.abs(v - whole(v))), 0.0)
    weights += weight
    fronts += tl.where(is_front, weight, 0.0)
    onward_u, onward_v = tl.where(is_front, on_u, onward_u), tl.where(is_front, on_v, onward_v)
    red = tl.where(its > 0, red * (albedo_r + gloss), red)
    green = tl.where(its > 0, green * (albedo_g + gloss), green)
    blue = tl.where(its > 0, blue * (albedo_b + gloss), blue)

    for k in tl.static_range(9):
        back = tl.load(seen + k * plane + behind, mask=edge, other=0.0)
        if FIRST:
            total = tl.where(now_front, tl.load(now + (b * 9 + k) * plane + at, mask=exists, other=0.0), back)
        else:
            total = tl.load(out + k * plane, mask=edge, other=0.0)
        value = (red if k == 0 else green if k == 1 else blue if k == 2 else albedo_r if k == 3 else albedo_g if k == 4
                 else albedo_b if k == 5 else nx if k == 6 else ny if k == 7 else nz)  # fmt: skip
        total += weight * tl.where(is_front, value, back)
        if LAST:
            was = tl.load(seen + k * plane + at, mask=exists, other=0.0)
            total = total / weights
            if k < 3:
                total = tl.where(tl.abs(total - was) <= same * was, was, total)
                total = was + light * (total - was)
            total = tl.where(edge, total, was)
        tl.store(out + k * plane, total, mask=exists)
    tl.store(coverage, tl.where(edge & now_front, 1.0, 0.0), mask=exists)
    tl.store(coverage + plane, tl.where(edge, fronts, 0.0), mask=exists)
    tl.store(coverage + 2 * plane, tl.where(edge, weights - 1, 0.0), mask=exists)
    tl.store(path, tl.where(inside, u + onward_u, FAR_AWAY), mask=exists)
    tl.store(path + plane, tl.where(inside, v + onward_v, FAR_AWAY), mask=exists)
    tl.store(path + 2 * plane, left * (1 - reset), mask=exists)
    tl.store(path + 3 * plane, weights, mask=exists)
    tl.store(path + 4 * plane, onward_u, mask=exists)
    tl.store(path + 5 * plane, onward_v, mask=exists)


def over_and_coverage(
    seen: Tensor, now: Sequence[Tensor], motion: Tensor, depth: Tensor, recent: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    seen, now, motion, depth = (t.contiguous() for t in (seen, torch.cat(now, dim=1), motion, depth))
    B, _, H, W = seen.shape
    path, out, coverage = seen.new_empty(B, 6, H, W), torch.empty_like(seen), seen.new_empty(B, 3, H, W)
    limits = OVER_APART, OVER_SPEED, OVER_SAME, OVER_LIGHT, GLOSS
    for j, kept in enumerate(recent):
        at = {"FIRST": j == 0, "LAST": j == len(recent) - 1, "BLOCK": BLOCK, "FAR_AWAY": FAR_AWAY}
        _over[grid(B, H, W)](
            seen, now, motion, depth, kept.contiguous(), path, out, coverage, H, W, kept.shape[1], *limits, **at
        )
    return out, coverage
