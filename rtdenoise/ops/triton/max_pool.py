"""`max_pool` of features in channels last: a row of the result is one run of numbers, its pixels' channels."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import greater

RUN = 1024


@triton.jit
def _max_pool(x, out, w, C, RUN: tl.constexpr):
    row = tl.cast(tl.program_id(1), tl.int64)
    at = tl.program_id(0) * RUN + tl.arange(0, RUN)
    exists, length = at < w * C, tl.cast(w, tl.int64) * C
    corner = x + 4 * row * length + at + at // C * C  # two rows of twice the length; pixel i lies at 2i
    p, q = tl.load(corner, mask=exists, other=0.0), tl.load(corner + C, mask=exists, other=0.0)
    corner += 2 * length
    r, s = tl.load(corner, mask=exists, other=0.0), tl.load(corner + C, mask=exists, other=0.0)
    tl.store(out + row * length + at, greater(greater(p, q), greater(r, s)), mask=exists)


def max_pool(x: Tensor) -> Tensor:
    B, C, H, W = x.shape
    out = torch.empty((B, C, H // 2, W // 2), dtype=x.dtype, device=x.device, memory_format=torch.channels_last)
    _max_pool[triton.cdiv(W // 2 * C, RUN), B * (H // 2)](x, out, W // 2, C, RUN=RUN)
    return out
