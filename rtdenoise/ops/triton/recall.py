"""`recall` in three launches: paths lead through all kept frames and compare light over cells, the cells tell what has
not changed, and that is summed up along the same paths, and along those of footprints."""

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
    RECALL_CELL,
    RECALL_EDGE_SPEED,
    RECALL_ROUNDING,
)
from .alike import alike, surface_at
from .common import BLOCK, grid, of_images, place, row_of
from .path import (
    beside,
    bounded,
    distance,
    edge_motion,
    end_of,
    frame_of,
    kept_at,
    kept_edge_at,
    onward,
    radiance,
    stacked,
    whole,
)
from .unchanged import unchanged

COLUMNS = 32  # of a program that sums over cells: one warp, so that sums need no shared memory
# With addresses from memory `_sum` would take 106 registers, and a third fewer programs would fit.
FEW_REGISTERS = {"maxnreg": 80} if torch.version.cuda else {}


@triton.jit
def _root(light):
    return tl.sqrt(tl.maximum(light, 0.0))


@triton.jit
def _beside(d, CELL: tl.constexpr, COLUMNS: tl.constexpr):
    """Sums over cells of the products of pixels in an even column and those beside them; d [CELL, cells, CELL]."""
    even, odd = tl.split(tl.reshape(d, (CELL, COLUMNS // CELL, CELL // 2, 2)))
    return tl.sum(tl.sum(even * odd, axis=2), axis=0)


@triton.jit
def _below(d, CELL: tl.constexpr, COLUMNS: tl.constexpr):
    """Likewise of pixels in an even row and those below them."""
    even, odd = tl.split(tl.permute(tl.reshape(d, (CELL // 2, 2, COLUMNS // CELL, CELL)), (0, 2, 3, 1)))
    return tl.sum(tl.sum(even * odd, axis=2), axis=0)


@triton.jit
def _compare(light, depth, normal, motion, recent, cells, H, W, B, frames, words, depth_tolerance, normal_tolerance,
             rounding, CELL: tl.constexpr, COLUMNS: tl.constexpr, FAR_AWAY: tl.constexpr):  # fmt: skip
    """Sums over cells of the differences between each kept frame and this one, of their squares with what is added, and
    of their products with that beside and that below, of pairs."""
    plane, rows = tl.cast(H, tl.int64) * W, tl.cdiv(H, CELL)
    b, row = row_of(rows)
    cell = tl.program_id(0) * (COLUMNS // CELL) + tl.arange(0, COLUMNS // CELL)
    y = row * CELL + tl.arange(0, CELL)[:, None, None]
    x = cell[None, :, None] * CELL + tl.arange(0, CELL)[None, None, :]
    exists = (y < H) & (x < W)
    at = y * W + x
    u = tl.load(motion + b * 2 * plane + at, mask=exists, other=0.0)
    v = tl.load(motion + (b * 2 + 1) * plane + at, mask=exists, other=0.0)
    d, nx, ny, nz = surface_at(depth + b * plane, normal + b * 3 * plane, plane, at, exists)
    light += b * 3 * plane + at
    now_r = _root(tl.load(light, mask=exists, other=0.0))
    now_g = _root(tl.load(light + plane, mask=exists, other=0.0))
    now_b = _root(tl.load(light + 2 * plane, mask=exists, other=0.0))
    least = rounding * (now_r * now_r + now_g * now_g + now_b * now_b)
    across = tl.cdiv(W, CELL)
    size = tl.cast(rows, tl.int64) * across
    for j in range(frames):
        u, v = bounded(u, FAR_AWAY), bounded(v, FAR_AWAY)
        there, inside = end_of(u, v, y, x, exists, H, W)
        kept = frame_of(recent, j) + b * words * plane
        red, green, blue, its, its_x, its_y, its_z, _, more_u, more_v = kept_at(kept, plane, there, inside)
        same = inside & alike(d, nx, ny, nz, its, its_x, its_y, its_z, depth_tolerance, normal_tolerance)
        r = tl.where(same, _root(red) - now_r, 0.0)
        g = tl.where(same, _root(green) - now_g, 0.0)
        a = tl.where(same, _root(blue) - now_b, 0.0)
        of_frame = cells + (tl.cast(j, tl.int64) * B + b) * 5 * size + row * across + cell
        for k in tl.static_range(4):
            term = r if k == 0 else g if k == 1 else a if k == 2 else r * r + g * g + a * a + tl.where(same, least, 0.0)
            tl.store(of_frame + k * size, tl.sum(tl.sum(term, axis=2), axis=0), mask=cell < across)
        products = _beside(r, CELL, COLUMNS) + _beside(g, CELL, COLUMNS) + _beside(a, CELL, COLUMNS)
        products += _below(r, CELL, COLUMNS) + _below(g, CELL, COLUMNS) + _below(a, CELL, COLUMNS)
        tl.store(of_frame + 4 * size, products, mask=cell < across)
        u, v = onward(u, v, more_u, more_v, inside, FAR_AWAY)


@triton.jit
def _sum(depth, normal, motion, uncovered, misplaced, lone, recent, stays, mean, count, seen, seen_count, H, W, B,
         frames, words, depth_tolerance, normal_tolerance, edge_speed, gloss, FOOTPRINT: tl.constexpr,
         MISPLACED: tl.constexpr, LONE: tl.constexpr, CELL: tl.constexpr, BLOCK: tl.constexpr,
         FAR_AWAY: tl.constexpr):  # fmt: skip
    """The means of what has not changed: of light, and with FOOTPRINT of all that was seen in the pixel."""
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at = y * W + x
    across = tl.cdiv(W, CELL)
    size = tl.cast(tl.cdiv(H, CELL), tl.int64) * across
    stays += b * size + y // CELL * across + x // CELL
    depth += b * plane
    normal += b * 3 * plane
    motion += b * 2 * plane
    u = tl.load(motion + at, mask=exists, other=0.0)
    v = tl.load(motion + plane + at, mask=exists, other=0.0)
    d, nx, ny, nz = surface_at(depth, normal, plane, at, exists)
    left = tl.where(exists, 1.0, 0.0)
    total = tl.zeros([BLOCK], tl.float32)
    r, g, a = total, total, total
    if FOOTPRINT:
        edge_u, edge_v, nearest = edge_motion(motion, depth, plane, y, x, exists, H, W, depth_tolerance, edge_speed)
        belongs = exists & (tl.load(uncovered + b * plane + at, mask=exists, other=1) == 0)
        less = tl.load(misplaced + b) if MISPLACED else 0.0
        if LONE:
            least = tl.load(lone + b * 2 * plane + at, mask=exists, other=1.0)
            greatest = tl.load(lone + (b * 2 + 1) * plane + at, mask=exists, other=0.0)
        edge_left, edge_total = left, total
        s0, s1, s2, s3, s4, s5, s6, s7, s8 = total, total, total, total, total, total, total, total, total
        above = surface_at(depth, normal, plane, beside(y, x, 1, H, W), exists)
        before = surface_at(depth, normal, plane, beside(y, x, 2, H, W), exists)
        after = surface_at(depth, normal, plane, beside(y, x, 3, H, W), exists)
        below = surface_at(depth, normal, plane, beside(y, x, 4, H, W), exists)
    for j in range(frames):
        kept = frame_of(recent, j) + b * words * plane
        same_light = tl.load(stays + tl.cast(j, tl.int64) * B * size, mask=exists, other=0.0)
        u, v = bounded(u, FAR_AWAY), bounded(v, FAR_AWAY)
        there, inside = end_of(u, v, y, x, exists, H, W)
        red, green, blue, its, its_x, its_y, its_z, reset, more_u, more_v = kept_at(kept, plane, there, inside)
        same = inside & alike(d, nx, ny, nz, its, its_x, its_y, its_z, depth_tolerance, normal_tolerance)
        weight = tl.where(same, left * same_light, 0.0)
        r += weight * red
        g += weight * green
        a += weight * blue
        total += weight
        left *= 1 - reset
        u, v = onward(u, v, more_u, more_v, inside, FAR_AWAY)
        if FOOTPRINT:
            edge_u, edge_v = bounded(edge_u, FAR_AWAY), bounded(edge_v, FAR_AWAY)
            there, inside = end_of(edge_u, edge_v, y, x, exists, H, W)
            red, green, blue, its, its_x, its_y, its_z, reset, _, _ = kept_at(kept, plane, there, inside)
            albedo_r, albedo_g, albedo_b, more_u, more_v = kept_edge_at(kept, plane, there, inside)
            shown = alike(d, nx, ny, nz, its, its_x, its_y, its_z, depth_tolerance, normal_tolerance)
            shown |= _of(above, its, its_x, its_y, its_z, depth_tolerance, normal_tolerance)
            shown |= _of(before, its, its_x, its_y, its_z, depth_tolerance, normal_tolerance)
            shown |= _of(after, its, its_x, its_y, its_z, depth_tolerance, normal_tolerance)
            shown |= _of(below, its, its_x, its_y, its_z, depth_tolerance, normal_tolerance)
            shown &= distance(its) >= (1 - depth_tolerance) * nearest
            if LONE:
                shown |= (its >= least) & (its <= greatest)
            shown &= inside & belongs
            du, dv = tl.abs(edge_u - whole(edge_u)), tl.abs(edge_v - whole(edge_v))
            weight = same_light * edge_left * (1 - du) * (1 - dv)
            if MISPLACED:
                weight = weight / (1 + less * (du * du + dv * dv))
            weight = tl.where(shown, weight, 0.0)
            red, green, blue = radiance(red, green, blue, albedo_r, albedo_g, albedo_b, its, gloss)
            s0 += weight * red
            s1 += weight * green
            s2 += weight * blue
            s3 += weight * albedo_r
            s4 += weight * albedo_g
            s5 += weight * albedo_b
            s6 += weight * its_x
            s7 += weight * its_y
            s8 += weight * its_z
            edge_total += weight
            edge_left *= 1 - reset
            edge_u, edge_v = onward(edge_u, edge_v, more_u, more_v, inside, FAR_AWAY)
    divisor = tl.maximum(total, 1e-6)
    mean += b * 3 * plane + at
    tl.store(mean, r / divisor, mask=exists)
    tl.store(mean + plane, g / divisor, mask=exists)
    tl.store(mean + 2 * plane, a / divisor, mask=exists)
    tl.store(count + b * plane + at, total, mask=exists)
    if FOOTPRINT:
        divisor = tl.maximum(edge_total, 1e-6)
        seen += b * 9 * plane + at
        for k in tl.static_range(9):
            tl.store(seen + k * plane, (s0, s1, s2, s3, s4, s5, s6, s7, s8)[k] / divisor, mask=exists)
        tl.store(seen_count + b * plane + at, edge_total, mask=exists)


@triton.jit
def _of(surface, depth, x, y, z, depth_tolerance, normal_tolerance):
    return alike(surface[0], surface[1], surface[2], surface[3], depth, x, y, z, depth_tolerance, normal_tolerance)


def recall(
    light: Tensor,
    motion: Tensor,
    depth: Tensor,
    normal: Tensor,
    recent: Sequence[Tensor],
    uncovered: Tensor | None,
    misplaced: Tensor | None,
    lone: Tensor | None,
) -> tuple[Tensor, ...]:
    light, motion, depth, normal = (t.contiguous() for t in (light, motion, depth, normal))
    B, _, H, W = light.shape
    K, h, w = len(recent), triton.cdiv(H, RECALL_CELL), triton.cdiv(W, RECALL_CELL)
    recent, words = stacked(recent)
    cells = light.new_empty(K, B, 5, h, w)
    tolerances, far = (DEPTH_TOLERANCE, MIN_NORMAL_COSINE), {"CELL": RECALL_CELL, "FAR_AWAY": FAR_AWAY}
    counts = H, W, B, K, words
    _compare[triton.cdiv(W, COLUMNS), B * h](
        light, depth, normal, motion, recent, cells, *counts, *tolerances, RECALL_ROUNDING, COLUMNS=COLUMNS,
        num_warps=1, **far,
    )  # fmt: skip
    stays = unchanged(cells)
    results = torch.empty_like(light), torch.empty_like(depth)
    masks = depth, depth, depth  # not read
    if uncovered is not None:
        less = depth if misplaced is None else of_images(misplaced, B)
        masks = uncovered.contiguous().view(torch.uint8), less, depth if lone is None else lone.contiguous()
        results += light.new_empty(B, 9, H, W), torch.empty_like(depth)
    _sum[grid(B, H, W)](
        depth, normal, motion, *masks, recent, stays, *results, *results[:4 - len(results)], *counts, *tolerances,
        RECALL_EDGE_SPEED, GLOSS, FOOTPRINT=uncovered is not None, MISPLACED=misplaced is not None,
        LONE=lone is not None, BLOCK=BLOCK, **far, **FEW_REGISTERS,
    )  # fmt: skip
    return results
