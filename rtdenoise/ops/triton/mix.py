"""`mix`: sums of what the noisy frame tells over cells, then the mixture."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import MIX_CELL, MIX_DARK, MIX_FAR, MIX_LARGEST, MIX_NOISE, MIX_TELLS, MIX_UNCOVERED
from .common import BLOCK, grid, lerp, of_images, place
from .curve import compressed, expanded


@triton.jit
def _told(first, other, noisy, scale, told, H, W, usual, dark, largest, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """Means of (p - q)(y - q), (p - q)² and (y - m)² over the pixels of each cell (`ops.mix.share_told`)."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i, j, exists = place(h, w, BLOCK)
    plane, size = tl.cast(H, tl.int64) * W, tl.cast(h, tl.int64) * w
    s = tl.load(scale + b)
    along = tl.zeros([BLOCK], tl.float32)
    square, noise, count = along, along, along
    for k in range(CELL * CELL):
        y, x = i * CELL + k // CELL, j * CELL + k % CELL
        inside = exists & (y < H) & (x < W)
        at = b * 3 * plane + y * W + x
        brightness = tl.zeros([BLOCK], tl.float32)
        for c in tl.static_range(3):
            p = tl.load(first + at + c * plane, mask=inside, other=0.0)
            q = tl.load(other + at + c * plane, mask=inside, other=0.0)
            brightness += q + usual * (p - q)
        relative = s / (s * brightness / 3 + dark)
        for c in tl.static_range(3):
            p = tl.load(first + at + c * plane, mask=inside, other=0.0)
            q = tl.load(other + at + c * plane, mask=inside, other=0.0)
            light = tl.load(noisy + at + c * plane, mask=inside, other=0.0)
            apart, left = relative * (p - q), tl.minimum(relative * (light - q), largest)
            rest = tl.minimum(relative * (light - (q + usual * (p - q))), largest)
            along += apart * left
            square += apart * apart
            noise += rest * rest
        count += tl.where(inside, 1.0, 0.0)
    told += b * 3 * size + i * w + j
    tl.store(told, along / count, mask=exists)
    tl.store(told + size, square / count, mask=exists)
    tl.store(told + 2 * size, noise / count, mask=exists)


@triton.jit
def _mean_around(told, i, j, h, w, exists):
    """The mean of a cell and the eight around it."""
    total = tl.zeros(j.shape, tl.float32)
    count = total
    for k in tl.static_range(9):
        y, x = i + k // 3 - 1, j + k % 3 - 1
        inside = exists & (y >= 0) & (y < h) & (x >= 0) & (x < w)
        total += tl.load(told + y * w + x, mask=inside, other=0.0)
        count += tl.where(inside, 1.0, 0.0)
    return total / tl.maximum(count, 1.0)


@triton.jit
def _between_cells(told, low_i, low_j, f, g, h, w, exists):
    high_i, high_j = tl.minimum(low_i + 1, h - 1), tl.minimum(low_j + 1, w - 1)
    top = _mean_around(told, low_i, low_j, h, w, exists) * (1 - g) + _mean_around(told, low_i, high_j, h, w, exists) * g
    low = _mean_around(told, high_i, low_j, h, w, exists) * (1 - g)
    low += _mean_around(told, high_i, high_j, h, w, exists) * g
    return top * (1 - f) + low * f


@triton.jit
def _mix(first, other, scale, trust, before, held, told, tells, depth, word, out, H, W, usual, share_before, lowest,
         smallest, far, telling_enough, uncovered, BEFORE: tl.constexpr, TOLD: tl.constexpr, SKY: tl.constexpr,
         WORD: tl.constexpr, CELL: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at, s = y * W + x, tl.load(scale + b)
    share = usual + tl.zeros([BLOCK], tl.float32)
    most = float("inf") + share  # that the first may differ by
    if TOLD:
        h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
        size = tl.cast(h, tl.int64) * w
        told += b * 3 * size
        v = tl.maximum((y + 0.5) / CELL - 0.5, 0.0)
        u = tl.maximum((x + 0.5) / CELL - 0.5, 0.0)
        i, j = v.to(tl.int32), u.to(tl.int32)
        along = _between_cells(told, i, j, v - i, u - j, h, w, exists)
        square = _between_cells(told + size, i, j, v - i, u - j, h, w, exists)
        noise = _between_cells(told + 2 * size, i, j, v - i, u - j, h, w, exists) + smallest
        found = tl.minimum(tl.maximum((usual * noise + along) / (noise + square), 0.0), 1.0)
        bounded = tl.minimum(tl.maximum(found, lowest), usual)
        telling = tl.load(tells + b * plane + at, mask=exists, other=0.0)
        found = bounded + telling * (found - bounded)
        share += (found - share) * (tl.load(word + b) if WORD else 1.0)
        most = tl.where(telling < telling_enough, uncovered, most)
    if SKY:
        greatest = tl.zeros([BLOCK], tl.float32)
        for k in tl.static_range(9):
            v, u = y + k // 3 - 1, x + k % 3 - 1
            inside = exists & (v >= 0) & (v < H) & (u >= 0) & (u < W)
            greatest = tl.maximum(greatest, tl.load(depth + b * plane + v * W + u, mask=inside, other=0.0))
        share = tl.where(greatest > 0, share, 0.0)
    trusted = tl.load(trust + b * plane + at, mask=exists, other=0.0)
    share *= trusted
    for c in tl.static_range(3):
        here = (b * 3 + c) * plane + at
        p = compressed(s * tl.maximum(tl.load(first + here, mask=exists, other=0.0), 0.0))
        q = compressed(s * tl.maximum(tl.load(other + here, mask=exists, other=0.0), 0.0))
        mixed = lerp(q, q + tl.minimum(tl.maximum(p - q, -most), most), share)
        if BEFORE:
            weight = trusted * share_before * tl.load(held + b * plane + at, mask=exists, other=0.0)
            past = compressed(s * tl.maximum(tl.load(before + here, mask=exists, other=0.0), 0.0))
            mixed += weight * tl.minimum(tl.maximum(past - mixed, -far), far)
        tl.store(out + here, expanded(mixed) / s, mask=exists)


def mix(
    first: Tensor,
    other: Tensor,
    scale: Tensor,
    trust: Tensor,
    shares: tuple[float, float, float],
    before: Tensor | None,
    held: Tensor | None,
    noisy: Tensor | None,
    tells: Tensor | None,
    depth: Tensor | None,
    word: Tensor | None,
) -> Tensor:
    first, other, trust = first.contiguous(), other.contiguous(), trust.contiguous()
    B, _, H, W = first.shape
    scale = of_images(scale, B)
    before, held = (first, trust) if before is None else (before.contiguous(), held.contiguous())
    told = trust
    if noisy is not None:
        h, w = triton.cdiv(H, MIX_CELL), triton.cdiv(W, MIX_CELL)
        told, limits = first.new_empty(B, 3, h, w), (shares[0], MIX_DARK, MIX_LARGEST)
        _told[grid(B, h, w)](first, other, noisy.contiguous(), scale, told, H, W, *limits, CELL=MIX_CELL, BLOCK=BLOCK)
    out = torch.empty_like(first)
    constants = {"BEFORE": before is not first, "TOLD": noisy is not None, "SKY": depth is not None}
    constants |= {"WORD": word is not None, "CELL": MIX_CELL}
    tells, depth = (trust if x is None else x.contiguous() for x in (tells, depth))
    word = scale if word is None else of_images(word.float(), B)
    _mix[grid(B, H, W)](
        first, other, scale, trust, before, held, told, tells, depth, word, out, H, W, *shares, MIX_NOISE, MIX_FAR,
        MIX_TELLS, MIX_UNCOVERED, BLOCK=BLOCK, **constants,
    )  # fmt: skip
    return out
