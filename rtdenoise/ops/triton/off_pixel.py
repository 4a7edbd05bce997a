"""`off_pixel`: some numbers in one launch."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ...constants import RECALL_NOISY
from .common import BLOCK


@triton.jit
def _off_pixel(noise, out, count, share, less, BLOCK: tl.constexpr):
    at = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    x = tl.load(noise + at, mask=at < count, other=1.0)
    x = 1 / tl.where(x < 1e-6, 1e-6, x) - less
    tl.store(out + at, share * tl.where(x < 0, 0.0, x), mask=at < count)


def off_pixel(noise: Tensor, share: float) -> Tensor:
    noise, count = noise.contiguous(), noise.numel()
    out = torch.empty_like(noise)
    _off_pixel[(triton.cdiv(count, BLOCK),)](noise, out, count, share, 1 / RECALL_NOISY, BLOCK=BLOCK)
    return out
