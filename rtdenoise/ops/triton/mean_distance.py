"""`mean_distance`: sums of parts of the image, then of these."""

from __future__ import annotations

import triton
import triton.language as tl
from torch import Tensor

from ...constants import MIN_DISTANCE

PART, AT_ONCE = 4096, 1024


@triton.jit
def _sums(depth, sums, N, PART: tl.constexpr):
    """Sum and number of a part's depths that are not 0."""
    b, part = tl.program_id(1).to(tl.int64), tl.program_id(0)
    at = part * PART + tl.arange(0, PART)
    value = tl.load(depth + b * N + at, mask=at < N, other=0.0)
    sums += 2 * (b * tl.cdiv(N, PART) + part)
    tl.store(sums, tl.sum(value, axis=0))
    tl.store(sums + 1, tl.sum(tl.where(value > 0, 1.0, 0.0), axis=0))


@triton.jit
def _mean(sums, out, parts, least, AT_ONCE: tl.constexpr):
    b = tl.program_id(0).to(tl.int64)
    total = tl.zeros([AT_ONCE], tl.float32)
    hits = total
    for start in range(0, parts, AT_ONCE):
        part = start + tl.arange(0, AT_ONCE)
        here = sums + 2 * (b * parts + part)
        total += tl.load(here, mask=part < parts, other=0.0)
        hits += tl.load(here + 1, mask=part < parts, other=0.0)
    mean = tl.sum(total, axis=0) / tl.maximum(tl.sum(hits, axis=0), 1.0)
    tl.store(out + b, tl.where(mean < least, least, mean))


def mean_distance(depth: Tensor) -> Tensor:
    depth, (B, _, H, W) = depth.contiguous(), depth.shape
    parts = triton.cdiv(H * W, PART)
    sums, out = depth.new_empty(B, parts, 2), depth.new_empty(B, 1, 1, 1)
    _sums[parts, B](depth, sums, H * W, PART=PART, num_warps=8)
    _mean[(B,)](sums, out, parts, MIN_DISTANCE, AT_ONCE=AT_ONCE)
    return out
