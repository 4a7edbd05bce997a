"""`to_planes` on tensor cores: a program goes down a strip of rows and reads each row of features three times:
products of a row hold what it gives to three rows of the result."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

BLOCK = 128  # columns of a strip
PADDED = 16  # columns of a product: those of three rows, `ops.to_planes.MOST` planes each, and some without weights
ROWS = 16  # of a strip; with a row above and one below a multiple of three


@triton.jit
def _to_planes(x, weight, bias, out, H, W, strips, of_output, of_input, of_row, of_column, C: tl.constexpr,
               O: tl.constexpr, CHANNELS: tl.constexpr, PRECISION: tl.constexpr, PADDED: tl.constexpr,
               ROWS: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, top = (tl.program_id(1) // strips).to(tl.int64), tl.program_id(1) % strips * ROWS
    j = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    plane, channel = tl.cast(H, tl.int64) * W, tl.arange(0, CHANNELS)
    column = tl.arange(0, PADDED)
    o, sums = column % O, column // O  # row i of the strip is summed up in the columns where `sums` is i % 3
    used = sums < 3
    start = tl.zeros([BLOCK, PADDED], tl.float32) + tl.load(bias + o).to(tl.float32)[None, :]
    total = start
    for first_row in range(0, ROWS + 2, 3):
        for k in tl.static_range(3):
            i = first_row + k - 1  # row of features, the last that row i - 1 of the result sees
            v = top + i + 0 * j
            above = (sums - k + 5) % 3  # 0 where the columns sum up row i - 1, 1 of row i, 2 of row i + 1
            for n in tl.static_range(3):
                u = j + n - 1
                inside = (v >= 0) & (v < H) & (u >= 0) & (u < W)
                there = x + (b * plane + v * W + u) * C
                tap = weight + o * of_output + (2 - above) * of_row + n * of_column
                for first in tl.static_range(0, C, CHANNELS):
                    c = first + channel
                    features = tl.load(there[:, None] + c[None, :], mask=inside[:, None], other=0.0)
                    weights = tl.load(tap[None, :] + c[:, None] * of_input, mask=used[None, :], other=0.0)
                    if PRECISION == "half":
                        total = tl.dot(features, weights, total)
                    else:
                        total = tl.dot(features.to(tl.float32), weights.to(tl.float32), total, input_precision="ieee")
            done = used & (above == 0)
            exists = (v > top) & (v <= top + ROWS) & (v <= H) & (j < W)
            at = out + (b * O + o[None, :]) * plane + ((v - 1) * W + j)[:, None]
            tl.store(at, total, mask=exists[:, None] & done[None, :])
            total = tl.where(done[None, :], start, total)


def to_planes(x: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    B, C, H, W = x.shape
    O = len(weight)
    out = x.new_empty((B, O, H, W), dtype=torch.float32)
    channels = next(n for n in (64, 32, 16) if C % n == 0)
    halves = x.is_cuda and x.dtype == weight.dtype != torch.float32  # the interpreter multiplies none
    precision, strips = "half" if halves else "ieee", triton.cdiv(H, ROWS)
    # Loads of further stages of a loop would need more shared memory than most GPUs have.
    _to_planes[triton.cdiv(W, BLOCK), B * strips](
        x, weight, bias, out, H, W, strips, *weight.stride(), C=C, O=O, CHANNELS=channels, PRECISION=precision,
        PADDED=PADDED, ROWS=ROWS, BLOCK=BLOCK, num_warps=2, num_stages=1,
    )  # fmt: skip
    return out
