"""`to_planes` on tensor cores: for each of nine taps a product of features and weights, summed in float32."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place

PADDED = 16  # planes that a product has, most of them without weights


@triton.jit
def _to_planes(x, weight, bias, out, H, W, C, of_output, of_input, of_row, of_column, O: tl.constexpr,
               CHANNELS: tl.constexpr, PRECISION: tl.constexpr, PADDED: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, i, j, exists = place(H, W, BLOCK)
    plane, channel, o = tl.cast(H, tl.int64) * W, tl.arange(0, CHANNELS), tl.arange(0, PADDED)
    total = tl.zeros([BLOCK, PADDED], tl.float32) + tl.load(bias + o, mask=o < O, other=0.0).to(tl.float32)[None, :]
    for k in tl.static_range(9):
        v, u = i + k // 3 - 1, j + k % 3 - 1
        inside = exists & (v >= 0) & (v < H) & (u >= 0) & (u < W)
        there = x + (b * plane + v * W + u) * C
        tap = weight + o * of_output + k // 3 * of_row + k % 3 * of_column
        for first in range(0, C, CHANNELS):
            c = first + channel
            features = tl.load(there[:, None] + c[None, :], mask=inside[:, None], other=0.0)
            weights = tl.load(tap[None, :] + c[:, None] * of_input, mask=o[None, :] < O, other=0.0)
            if PRECISION == "half":
                total = tl.dot(features, weights, total)
            else:
                total = tl.dot(features.to(tl.float32), weights.to(tl.float32), total, input_precision="ieee")
    at = out + (b * O + o[None, :]) * plane + (i * W + j)[:, None]
    tl.store(at, total, mask=exists[:, None] & (o[None, :] < O))


def to_planes(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    B, C, H, W = x.shape
    O = len(weight)
    out = x.new_empty((B, O, H, W), dtype=torch.float32)
    channels = next(n for n in (64, 32, 16) if C % n == 0)
    halves = x.is_cuda and x.dtype == weight.dtype != torch.float32  # the interpreter multiplies none
    precision = "half" if halves else "ieee"
    _to_planes[grid(B, H, W)](
        x, weight, bias, out, H, W, C, *weight.stride(), O=O, CHANNELS=channels, PRECISION=precision, PADDED=PADDED,
        BLOCK=BLOCK,
    )  # fmt: skip
    return out
