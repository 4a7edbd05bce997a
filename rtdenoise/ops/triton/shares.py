"""`shares`: the sigmoid of logits by cells."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ..logits import strides
from .common import BLOCK, grid, place
from .logits import offset


@triton.jit
def _shares(logits, out, H, W, batch, stride, cell_row, row, cell, step, N: tl.constexpr, BLOCK: tl.constexpr):
    b, y, x, exists = place(H, W, BLOCK)
    plane, stride = tl.cast(H, tl.int64) * W, tl.cast(stride, tl.int64)
    logits += b * batch + offset(y, x, cell_row, row, cell, step)
    out += b * N * plane + y * W + x
    for k in tl.static_range(N):
        value = tl.load(logits + k * stride, mask=exists, other=0.0).to(tl.float32)
        tl.store(out + k * plane, 1 / (1 + tl.exp(-value)), mask=exists)


def shares(logits: Tensor, size: tuple[int, int]) -> Tensor:
    B, N = logits.shape[0], logits.shape[3]
    out = torch.empty(B, N, *size, dtype=torch.float32, device=logits.device)
    _shares[grid(B, *size)](logits, out, *size, *strides(logits), N=N, BLOCK=BLOCK)
    return out
