"""`gain`: sums over cells, two sizes of squares, then the cells; `relit_`: their pixels."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import RELIT_CELL, RELIT_DARKER, RELIT_FROM, RELIT_MOST, RELIT_ROUNDING, RELIT_SIDES, RELIT_WHOLE
from .cells import between
from .common import BLOCK, grid, place

SUMS = 6  # of three channels, before and now


@triton.jit
def _sum_cells(before, now, found, cells, H, W, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """The sums of each cell, [B, SUMS, h, w]."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    b, i, j, exists = place(h, w, BLOCK)
    plane, size = tl.cast(H, tl.int64) * W, tl.cast(h, tl.int64) * w
    cells += b * 6 * size + i * w + j
    for c in tl.static_range(3):
        then = tl.zeros([BLOCK], tl.float32)
        light = then
        for k in range(CELL * CELL):
            y, x = i * CELL + k // CELL, j * CELL + k % CELL
            inside = exists & (y < H) & (x < W)
            at = b * plane + y * W + x
            has = inside & (tl.load(found + at, mask=inside, other=0) != 0)
            at += (2 * b + c) * plane
            then += tl.load(before + at, mask=has, other=0.0)
            light += tl.load(now + at, mask=has, other=0.0)
        tl.store(cells + c * size, then, mask=exists)
        tl.store(cells + (3 + c) * size, light, mask=exists)


@triton.jit
def _sum_quarters(cells, first, out, h, w, FIRST: tl.constexpr, HALF: tl.constexpr, BLOCK: tl.constexpr):
    """The sums of quarters of squares, of HALF × HALF cells, [B, SUMS, m, n]; unless FIRST, before is as bright as
    `first` says."""
    m, n = tl.cdiv(h, HALF), tl.cdiv(w, HALF)
    image, y, x, exists = place(m, n, BLOCK)  # channels of images
    total = tl.zeros([BLOCK], tl.float32)
    for k in tl.static_range(HALF * HALF):
        i, j = y * HALF + k // HALF, x * HALF + k % HALF
        at = cells + image * tl.cast(h, tl.int64) * w + i * w + j
        total += tl.load(at, mask=exists & (i < h) & (j < w), other=0.0)
    if not FIRST:
        k, q = tl.cdiv(m, 4), tl.cdiv(n, 4)
        g = between(first + (image // 6 * 3 + image % 3) * k * q, y, x, exists, k, q, 4)
        total *= tl.where(image % 6 < 3, tl.exp(g), 1.0)
    tl.store(out + image * tl.cast(m, tl.int64) * n + y * n + x, total, mask=exists)


@triton.jit
def _brighter(quarters, gains, h, w, rounding, darker, start, whole, most, BLOCK: tl.constexpr):
    """g of squares, [B, 3, m, n], from the sums of their quarters, [B, SUMS, h, w]."""
    m, n = tl.cdiv(h, 2), tl.cdiv(w, 2)
    b, i, j, exists = place(m, n, BLOCK)
    size, squares = tl.cast(h, tl.int64) * w, tl.cast(m, tl.int64) * n
    quarters += b * 6 * size
    r = tl.zeros([BLOCK], tl.float32)
    g, a, r_now, g_now, a_now, noise = r, r, r, r, r, r
    for k in range(36):
        y, x = 2 * i - 2 + k // 6, 2 * j - 2 + k % 6
        inside = exists & (y >= 0) & (y < h) & (x >= 0) & (x < w)
        at = quarters + y * w + x
        r += tl.load(at, mask=inside, other=0.0)
        g += tl.load(at + size, mask=inside, other=0.0)
        a += tl.load(at + 2 * size, mask=inside, other=0.0)
        r_now += tl.load(at + 3 * size, mask=inside, other=0.0)
        g_now += tl.load(at + 4 * size, mask=inside, other=0.0)
        a_now += tl.load(at + 5 * size, mask=inside, other=0.0)
    share = 1 / tl.maximum(r + g + a + r_now + g_now + a_now, 1e-30)  # squares of light itself may be infinite
    for k in range(36):
        y, x = 2 * i - 2 + k // 6, 2 * j - 2 + k % 6
        inside = exists & (y >= 0) & (y < h) & (x >= 0) & (x < w)
        for c in tl.static_range(3):
            at = quarters + c * size + y * w + x
            d = tl.load(at, mask=inside, other=0.0) - tl.load(at + 3 * size, mask=inside, other=0.0)
            noise += share * d * (share * d)
    u, v, t = share * (r - r_now), share * (g - g_now), share * (a - a_now)
    least = rounding * share
    noise += least * r * (least * r) + least * g * (least * g) + least * a * (least * a)
    q = (u * u + v * v + t * t) / tl.maximum(noise, 1e-30)
    q = tl.where(r_now + g_now + a_now < r + g + a, q / darker, q)
    sure = (q - start) / (whole - start)
    sure = tl.minimum(tl.maximum(sure, 0.0), 1.0)
    gains += b * 3 * squares + i * n + j
    for c in tl.static_range(3):
        then, light = (r, g, a)[c], (r_now, g_now, a_now)[c]
        times = tl.minimum(tl.maximum(light / tl.maximum(then, 1e-37), 1 / most), most)
        tl.store(gains + c * squares, sure * tl.log(tl.where(then > 0, times, 1.0)), mask=exists)


@triton.jit
def _gain(first, second, out, h, w, CELLS: tl.constexpr, BLOCK: tl.constexpr):
    """The gain of each cell of [B, 3, h, w]; `first` is of squares of CELLS × CELLS cells, `second` of half as many."""
    n, i, j, exists = place(h, w, BLOCK)  # n: channels of images
    m, k = tl.cdiv(h, CELLS), tl.cdiv(w, CELLS)
    g = between(first + n * m * k, i, j, exists, m, k, CELLS)
    m, k = tl.cdiv(h, CELLS // 2), tl.cdiv(w, CELLS // 2)
    g += between(second + n * m * k, i, j, exists, m, k, CELLS // 2)
    tl.store(out + n * tl.cast(h, tl.int64) * w + i * w + j, tl.exp(g), mask=exists)


@triton.jit
def _relit(image, gain, C, H, W, CELL: tl.constexpr, BLOCK: tl.constexpr):
    """Three channels of [B, C, H, W], in place."""
    h, w = tl.cdiv(H, CELL), tl.cdiv(W, CELL)
    n, i, j, exists = place(h, w, BLOCK)
    times = tl.load(gain + n * tl.cast(h, tl.int64) * w + i * w + j, mask=exists, other=1.0)
    image += (n // 3 * C + n % 3) * tl.cast(H, tl.int64) * W
    for k in tl.static_range(CELL * CELL):
        y, x = i * CELL + k // CELL, j * CELL + k % CELL
        inside = exists & (y < H) & (x < W)
        at = image + y * W + x
        tl.store(at, times * tl.load(at, mask=inside, other=0.0), mask=inside)


def gain(before: Tensor, now: Tensor, found: Tensor) -> Tensor:
    before, now, found = before.contiguous(), now.contiguous(), found.contiguous()
    B, _, H, W = now.shape
    h, w = triton.cdiv(H, RELIT_CELL), triton.cdiv(W, RELIT_CELL)
    cells, out = now.new_empty(B, SUMS, h, w), now.new_empty(B, 3, h, w)
    _sum_cells[grid(B, h, w)](before, now, found, cells, H, W, CELL=RELIT_CELL, BLOCK=BLOCK)
    gains: list[Tensor] = []
    for side in RELIT_SIDES:
        half = side // 2
        m, n = triton.cdiv(h, half), triton.cdiv(w, half)
        quarters, first = now.new_empty(B, SUMS, m, n), gains[0] if gains else cells
        kinds = {"FIRST": not gains, "HALF": half, "BLOCK": BLOCK}
        _sum_quarters[grid(SUMS * B, m, n)](cells, first, quarters, h, w, **kinds)
        squares = triton.cdiv(m, 2), triton.cdiv(n, 2)
        gains.append(now.new_empty(B, 3, *squares))
        bounds = RELIT_ROUNDING, RELIT_DARKER, RELIT_FROM, RELIT_WHOLE, RELIT_MOST
        _brighter[grid(B, *squares)](quarters, gains[-1], m, n, *bounds, BLOCK=BLOCK)
    _gain[grid(3 * B, h, w)](*gains, out, h, w, CELLS=RELIT_SIDES[0], BLOCK=BLOCK)
    return out


def relit_(image: Tensor, gain: Tensor) -> Tensor:
    B, C, H, W = image.shape
    h, w = gain.shape[2:]
    _relit[grid(3 * B, h, w)](image, gain.contiguous(), C, H, W, CELL=RELIT_CELL, BLOCK=BLOCK)
    return image
