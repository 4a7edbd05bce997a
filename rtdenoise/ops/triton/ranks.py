"""Statistics by rank, each of a row by one program that does not sort it: it finds the value of a rank by its bits, two
at a time. The first CHUNK values stay in registers, others are read anew."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import BRIGHTNESS_TENTHS, MIN_BRIGHTNESS

CHUNK = 16384
BITS = tl.constexpr(21)  # of a count
COUNTED = tl.constexpr((1 << 21) - 1)


@triton.jit
def _keys(values, start, N, CHUNK: tl.constexpr):
    """Values, and whole numbers in the same order; NaN and what is beyond the end are the greatest."""
    at = start + tl.arange(0, CHUNK)
    x = tl.load(values + at, mask=at < N, other=float("nan"))
    bits = x.to(tl.uint32, bitcast=True)
    return x, tl.where(x == x, bits ^ tl.where(bits >= 0x80000000, 0xFFFFFFFF, 0x80000000), 0xFFFFFFFF)


@triton.jit
def _less(keys, bound, step):
    """How many keys are below the bound plus one, two and three steps, in one number."""
    one, two = (keys < bound + step).to(tl.int64), (keys < bound + 2 * step).to(tl.int64)
    three = (keys < bound + 3 * step).to(tl.int64)
    return tl.sum(one + (two << BITS) + (three << 2 * BITS), axis=0)


@triton.jit
def _select(values, N, rank, CHUNK: tl.constexpr):
    """The key of a rank, 0 for the least: the greatest number that no more than `rank` keys are below."""
    _, first = _keys(values, 0, N, CHUNK)
    found, step = tl.full([], 0, tl.uint32), tl.full([], 1 << 30, tl.uint32)
    for _ in range(16):
        count = _less(first, found, step)
        for start in range(CHUNK, N, CHUNK):
            count += _less(_keys(values, start, N, CHUNK)[1], found, step)
        steps = ((count & COUNTED) <= rank).to(tl.uint32) + ((count >> BITS & COUNTED) <= rank).to(tl.uint32)
        found += step * (steps + ((count >> 2 * BITS) <= rank).to(tl.uint32))
        step = step >> 2
    return found


@triton.jit
def _value(key):
    return (key ^ tl.where(key >= 0x80000000, 0x80000000, 0xFFFFFFFF)).to(tl.float32, bitcast=True)


@triton.jit
def _kth_greatest(values, out, N, k, CHUNK: tl.constexpr):
    b = tl.program_id(0).to(tl.int64)
    tl.store(out + b, _value(_select(values + b * N, N, N - k, CHUNK)))


@triton.jit
def _exposure_of(means, out, N, tenths, least, CHUNK: tl.constexpr):
    b = tl.program_id(0).to(tl.int64)
    means += b * N
    black = tl.full([], 0, tl.int32)
    for start in range(0, N, CHUNK):
        x, _ = _keys(means, start, N, CHUNK)
        black += tl.sum((x <= 0).to(tl.int32), axis=0)
    left_out = tl.maximum(2 * black - N, 0)
    count = tl.maximum((N - left_out) * tenths // 10, tl.minimum(black, N - black) + 1)
    end = tl.minimum(left_out + count, N)
    last = _select(means, N, end - 1, CHUNK)
    total, number = tl.full([], 0, tl.float32), tl.full([], 0, tl.int32)
    for start in range(0, N, CHUNK):
        x, keys = _keys(means, start, N, CHUNK)
        total += tl.sum(tl.where(keys < last, x, 0.0), axis=0)
        number += tl.sum((keys < last).to(tl.int32), axis=0)
    mean = (total + (end - number) * _value(last)) / count  # several may be as great as the last
    tl.store(out + b, 1 / tl.where(mean < least, least, mean))


@triton.jit
def _median(values, out, N, CHUNK: tl.constexpr):
    b = tl.program_id(0).to(tl.int64)
    values += b * N
    number = tl.full([], 0, tl.int32)
    for start in range(0, N, CHUNK):
        x, _ = _keys(values, start, N, CHUNK)
        number += tl.sum((x == x).to(tl.int32), axis=0)
    found = _value(_select(values, N, tl.maximum(number - 1, 0) >> 1, CHUNK))
    tl.store(out + b, tl.where(number > 0, found, float("inf")))


def _constants(N: int) -> dict[str, int]:
    chunk = min(CHUNK, triton.next_power_of_2(N))
    return {"CHUNK": chunk, "num_warps": max(4, chunk // 512)}


def kth_greatest(values: Tensor, k: int) -> Tensor:
    values, (B, N) = values.contiguous(), values.shape
    out = values.new_empty(B, 1)
    _kth_greatest[(B,)](values, out, N, k, **_constants(N))
    return out


def exposure_of(means: Tensor) -> Tensor:
    means, (B, N) = means.contiguous(), means.shape
    out = means.new_empty(B, 1, 1, 1)
    _exposure_of[(B,)](means, out, N, BRIGHTNESS_TENTHS, MIN_BRIGHTNESS, **_constants(N))
    return out


def median(values: Tensor) -> Tensor:
    values, (B, N) = values.contiguous(), values.shape
    out = values.new_empty(B, 1, 1, 1)
    _median[(B,)](values, out, N, **_constants(N))
    return out
