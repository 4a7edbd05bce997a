"""`recall`. A frame after the other, kernels follow the paths and compare light over cells; what has not changed is
summed up, and footprints follow paths of their own."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import (
    DEPTH_TOLERANCE,
    FAR_AWAY,
    GLOSS,
    MIN_NORMAL_COSINE,
    RECALL_ALIKE,
    RECALL_CELL,
    RECALL_CHANGED,
    RECALL_EDGE_SPEED,
    RECALL_WIDE_ALIKE,
    RECALL_WIDE_CHANGED,
)
from .alike import alike, surface_at
from .common import BLOCK, grid, place
from .path import beside, bounded, distance, end_of, kept_at, kept_edge_at, whole

COLUMNS = 64  # of a program that sums over cells


@triton.jit
def _root(light):
    return tl.sqrt(tl.maximum(light, 0.0))


@triton.jit
def _look(light, depth, normal, kept, motion, path, found, cells, H, W, words, depth_tolerance, normal_tolerance,
          FIRST: tl.constexpr, CELL: tl.constexpr, COLUMNS: tl.constexpr, FAR_AWAY: tl.constexpr):  # fmt: skip
    """What a kept frame shows at the end of each path, the share that resets left of it, and sums over cells."""
    plane, rows = tl.cast(H, tl.int64) * W, tl.cdiv(H, CELL)
    b = (tl.program_id(1) // rows).to(tl.int64)
    row = tl.program_id(1) % rows
    y = row * CELL + tl.arange(0, CELL)[:, None]
    x = tl.program_id(0) * COLUMNS + tl.arange(0, COLUMNS)[None, :]
    exists = (y < H) & (x < W)
    at = y * W + x
    path += b * 3 * plane + at
    if FIRST:
        u = tl.load(motion + b * 2 * plane + at, mask=exists, other=0.0)
        v = tl.load(motion + (b * 2 + 1) * plane + at, mask=exists, other=0.0)
        left = tl.where(exists, 1.0, 0.0)
    else:
        u, v = tl.load(path, mask=exists, other=0.0), tl.load(path + plane, mask=exists, other=0.0)
        left = tl.load(path + 2 * plane, mask=exists, other=0.0)
    u, v = bounded(u, FAR_AWAY), bounded(v, FAR_AWAY)
    there, inside = end_of(u, v, y, x, exists, H, W)
    kept += b * words * plane
    red, green, blue, far, nx, ny, nz, reset, on_u, on_v = kept_at(kept, plane, there, inside)
    d, hx, hy, hz = surface_at(depth + b * plane, normal + b * 3 * plane, plane, at, exists)
    same = inside & alike(d, hx, hy, hz, far, nx, ny, nz, depth_tolerance, normal_tolerance)

    found += b * 4 * plane + at
    tl.store(found, red, mask=exists)
    tl.store(found + plane, green, mask=exists)
    tl.store(found + 2 * plane, blue, mask=exists)
    tl.store(found + 3 * plane, tl.where(same, left, 0.0), mask=exists)
    tl.store(path, tl.where(inside, u + on_u, FAR_AWAY), mask=exists)
    tl.store(path + plane, tl.where(inside, v + on_v, FAR_AWAY), mask=exists)
    tl.store(path + 2 * plane, left * (1 - reset), mask=exists)

    light += b * 3 * plane + at
    r = tl.where(same, _root(red) - _root(tl.load(light, mask=exists, other=0.0)), 0.0)
    g = tl.where(same, _root(green) - _root(tl.load(light + plane, mask=exists, other=0.0)), 0.0)
    a = tl.where(same, _root(blue) - _root(tl.load(light + 2 * plane, mask=exists, other=0.0)), 0.0)
    across = tl.cdiv(W, CELL)
    size = tl.cast(rows, tl.int64) * across
    cell = tl.program_id(0) * (COLUMNS // CELL) + tl.arange(0, COLUMNS // CELL)
    cells += b * 4 * size + row * across + cell
    for k in tl.static_range(4):
        term = r if k == 0 else g if k == 1 else a if k == 2 else r * r + g * g + a * a
        sums = tl.sum(tl.sum(tl.reshape(term, [CELL, COLUMNS // CELL, CELL]), axis=2), axis=0)
        tl.store(cells + k * size, sums, mask=cell < across)


@triton.jit
def _unchanged(cells, i, j, h, w, size, exists, SIDE: tl.constexpr, whole, none):
    """The factor of SIDE × SIDE cells and as many on each side of them."""
    top, left = i // SIDE * SIDE - SIDE, j // SIDE * SIDE - SIDE
    r = tl.zeros(j.shape, tl.float32)
    g, b, square = r, r, r
    for k in tl.static_range(9 * SIDE * SIDE):
        y, x = top + k // (3 * SIDE), left + k % (3 * SIDE)
        inside = exists & (y >= 0) & (y < h) & (x >= 0) & (x < w)
        at = cells + y * w + x
        r += tl.load(at, mask=inside, other=0.0)
        g += tl.load(at + size, mask=inside, other=0.0)
        b += tl.load(at + 2 * size, mask=inside, other=0.0)
        square += tl.load(at + 3 * size, mask=inside, other=0.0)
    q = (r * r + g * g + b * b) / tl.maximum(square, 1e-30)
    return tl.minimum(tl.maximum((none - q) / (none - whole), 0.0), 1.0)


@triton.jit
def _stays(cells, stays, H, W, alike, changed, wide_alike, wide_changed, BLOCK: tl.constexpr):
    """How far light has stayed as it is in each of H × W cells."""
    b, y, x, exists = place(H, W, BLOCK)
    size = tl.cast(H, tl.int64) * W
    cells += b * 4 * size
    narrow = _unchanged(cells, y, x, H, W, size, exists, 1, alike, changed)
    wide = _unchanged(cells, y, x, H, W, size, exists, 2, wide_alike, wide_changed)
    tl.store(stays + b * size + y * W + x, narrow * wide, mask=exists)


@triton.jit
def _mean(found, stays, mean, count, H, W, B, frames, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """The mean of what was found in all frames."""
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    across = tl.cdiv(W, CELL)
    size = tl.cast(tl.cdiv(H, CELL), tl.int64) * across
    at, cell = y * W + x, y // CELL * across + x // CELL
    r = tl.zeros([BLOCK], tl.float32)
    g, a, total = r, r, r
    for j in range(frames):
        n = tl.cast(j, tl.int64) * B + b
        here = found + n * 4 * plane + at
        weight = tl.load(here + 3 * plane, mask=exists, other=0.0)
        weight *= tl.load(stays + n * size + cell, mask=exists, other=0.0)
        r += weight * tl.load(here, mask=exists, other=0.0)
        g += weight * tl.load(here + plane, mask=exists, other=0.0)
        a += weight * tl.load(here + 2 * plane, mask=exists, other=0.0)
        total += weight
    divisor = tl.maximum(total, 1e-6)
    mean += b * 3 * plane + at
    tl.store(mean, r / divisor, mask=exists)
    tl.store(mean + plane, g / divisor, mask=exists)
    tl.store(mean + 2 * plane, a / divisor, mask=exists)
    tl.store(count + b * plane + at, total, mask=exists)


@triton.jit
def _see(depth, normal, motion, uncovered, misplaced, kept, stays, path, seen, count, H, W, words, depth_tolerance,
         normal_tolerance, edge_speed, gloss, FIRST: tl.constexpr, LAST: tl.constexpr, CELL: tl.constexpr,
         BLOCK: tl.constexpr, FAR_AWAY: tl.constexpr):  # fmt: skip
    """Add to each footprint what a kept frame saw along the path of the edge in the pixel."""
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at = y * W + x
    depth += b * plane
    normal += b * 3 * plane
    path += b * 4 * plane + at
    seen += b * 9 * plane + at
    count += b * plane + at
    if FIRST:
        motion += b * 2 * plane
        own_u = tl.load(motion + at, mask=exists, other=0.0)
        own_v = tl.load(motion + plane + at, mask=exists, other=0.0)
        own = distance(tl.load(depth + at, mask=exists, other=0.0))
        u, v, nearest = own_u, own_v, own
        for k in tl.static_range(1, 5):
            other_at = beside(y, x, k, H, W)
            other = distance(tl.load(depth + other_at, mask=exists, other=0.0))
            nearer = other < (1 - depth_tolerance) * nearest
            u = tl.where(nearer, tl.load(motion + other_at, mask=exists, other=0.0), u)
            v = tl.where(nearer, tl.load(motion + plane + other_at, mask=exists, other=0.0), v)
            nearest = tl.where(nearer, other, nearest)
        slow = (u - own_u) * (u - own_u) + (v - own_v) * (v - own_v) <= edge_speed * edge_speed
        u, v, nearest = tl.where(slow, u, own_u), tl.where(slow, v, own_v), tl.where(slow, nearest, own)
        left = tl.where(exists, 1.0, 0.0)
        tl.store(path + 3 * plane, nearest, mask=exists)
    else:
        u, v = tl.load(path, mask=exists, other=0.0), tl.load(path + plane, mask=exists, other=0.0)
        left = tl.load(path + 2 * plane, mask=exists, other=0.0)
        nearest = tl.load(path + 3 * plane, mask=exists, other=0.0)
    u, v = bounded(u, FAR_AWAY), bounded(v, FAR_AWAY)
    there, inside = end_of(u, v, y, x, exists, H, W)
    kept += b * words * plane
    red, green, blue, far, nx, ny, nz, reset, _, _ = kept_at(kept, plane, there, inside)
    albedo_r, albedo_g, albedo_b, on_u, on_v = kept_edge_at(kept, plane, there, inside)

    shown = tl.zeros([BLOCK], tl.int1)
    for k in tl.static_range(5):
        d, hx, hy, hz = surface_at(depth, normal, plane, beside(y, x, k, H, W), exists)
        shown = shown | alike(d, hx, hy, hz, far, nx, ny, nz, depth_tolerance, normal_tolerance)
    shown = shown & (distance(far) >= (1 - depth_tolerance) * nearest) & inside
    shown = shown & (tl.load(uncovered + b * plane + at, mask=exists, other=1) == 0)
    du, dv = tl.abs(u - whole(u)), tl.abs(v - whole(v))
    across = tl.cdiv(W, CELL)
    size = tl.cast(tl.cdiv(H, CELL), tl.int64) * across
    weight = tl.load(stays + b * size + y // CELL * across + x // CELL, mask=exists, other=0.0)
    weight *= left * (1 - du) * (1 - dv) / (1 + tl.load(misplaced + b) * (du * du + dv * dv))
    weight = tl.where(shown, weight, 0.0)
    red = tl.where(far > 0, red * (albedo_r + gloss), red)
    green = tl.where(far > 0, green * (albedo_g + gloss), green)
    blue = tl.where(far > 0, blue * (albedo_b + gloss), blue)

    total = weight if FIRST else weight + tl.load(count, mask=exists, other=0.0)
    tl.store(count, total, mask=exists)
    divisor = tl.maximum(total, 1e-6) if LAST else 1.0
    for k in tl.static_range(9):
        value = (red if k == 0 else green if k == 1 else blue if k == 2 else albedo_r if k == 3 else albedo_g if k == 4
                 else albedo_b if k == 5 else nx if k == 6 else ny if k == 7 else nz)  # fmt: skip
        value = tl.where(shown, weight * value, 0.0)
        value = value if FIRST else value + tl.load(seen + k * plane, mask=exists, other=0.0)
        tl.store(seen + k * plane, value / divisor, mask=exists)
    tl.store(path, tl.where(inside, u + on_u, FAR_AWAY), mask=exists)
    tl.store(path + plane, tl.where(inside, v + on_v, FAR_AWAY), mask=exists)
    tl.store(path + 2 * plane, left * (1 - reset), mask=exists)


def recall(
    light: Tensor,
    motion: Tensor,
    depth: Tensor,
    normal: Tensor,
    recent: Sequence[Tensor],
    uncovered: Tensor | None,
    misplaced: Tensor | None,
) -> tuple[Tensor, ...]:
    light, motion, depth, normal = (t.contiguous() for t in (light, motion, depth, normal))
    recent = [kept.contiguous() for kept in recent]
    B, _, H, W = light.shape
    K, h, w = len(recent), triton.cdiv(H, RECALL_CELL), triton.cdiv(W, RECALL_CELL)
    path, found = light.new_empty(B, 3, H, W), light.new_empty(K, B, 4, H, W)
    cells, stays = light.new_empty(K, B, 4, h, w), light.new_empty(K, B, h, w)
    tests = RECALL_ALIKE, RECALL_CHANGED, RECALL_WIDE_ALIKE, RECALL_WIDE_CHANGED
    tolerances, far = (DEPTH_TOLERANCE, MIN_NORMAL_COSINE), {"CELL": RECALL_CELL, "FAR_AWAY": FAR_AWAY}
    for j, kept in enumerate(recent):
        _look[triton.cdiv(W, COLUMNS), B * h](
            light, depth, normal, kept, motion, path, found[j], cells[j], H, W, kept.shape[1], *tolerances,
            FIRST=j == 0, COLUMNS=COLUMNS, **far,
        )  # fmt: skip
        _stays[grid(B, h, w)](cells[j], stays[j], h, w, *tests, BLOCK=BLOCK)
    mean, count = torch.empty_like(light), torch.empty_like(depth)
    _mean[grid(B, H, W)](found, stays, mean, count, H, W, B, K, CELL=RECALL_CELL, BLOCK=BLOCK)
    if uncovered is None:
        return mean, count
    uncovered = uncovered.contiguous().view(torch.uint8)
    less = light.new_zeros(B) if misplaced is None else misplaced.expand(B, 1, 1, 1).reshape(B).contiguous()
    path, seen, weights = light.new_empty(B, 4, H, W), light.new_empty(B, 9, H, W), torch.empty_like(depth)
    for j, kept in enumerate(recent):
        _see[grid(B, H, W)](
            depth, normal, motion, uncovered, less, kept, stays[j], path, seen, weights, H, W, kept.shape[1],
            *tolerances, RECALL_EDGE_SPEED, GLOSS, FIRST=j == 0, LAST=j == K - 1, BLOCK=BLOCK, **far,
        )  # fmt: skip
    return mean, count, seen, weights
