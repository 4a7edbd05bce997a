"""`features`, channels last: planes are compressed, converted and transposed in one pass."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import torch
import triton
import triton.language as tl
from torch import Tensor

from .curve import compressed
from .pixels import grid, here

PIXELS = 128  # of a program


@triton.jit
def _joined(images, other, b, plane, at, exists, ENDS: tl.constexpr, FLAGS: tl.constexpr, CP: tl.constexpr):
    """Images joined along channels, [BLOCK, CP]: the k-th one from channel ENDS[k] to ENDS[k + 1], of bytes where
    FLAGS[k]. Addresses are chosen first, from `other` on, so that one load reads all that are of floats."""
    c = tl.arange(0, CP)[None, :]
    number, source = c < 0, other + 0 * c
    for k in tl.static_range(len(FLAGS)):
        if not FLAGS[k]:
            inside = (c >= ENDS[k]) & (c < ENDS[k + 1])
            source = tl.where(inside, images[k] + (b * (ENDS[k + 1] - ENDS[k]) + c - ENDS[k]) * plane, source)
            number = number | inside
    values = tl.load(source + at[:, None], mask=exists[:, None] & number, other=0.0)
    for k in tl.static_range(len(FLAGS)):
        if FLAGS[k]:
            inside = (c >= ENDS[k]) & (c < ENDS[k + 1])
            source_of_flags = images[k] + (b * (ENDS[k + 1] - ENDS[k]) + c - ENDS[k]) * plane + at[:, None]
            flags = tl.load(source_of_flags, mask=exists[:, None] & inside, other=0)
            values = tl.where(inside, flags.to(tl.float32), values)
    return values


@triton.jit
def _features(light, guides, scale, out, plane, unit, LIT: tl.constexpr, LIT_FLAGS: tl.constexpr, ENDS: tl.constexpr,
              FLAGS: tl.constexpr, LP: tl.constexpr, GP: tl.constexpr, ALL: tl.constexpr,
              BLOCK: tl.constexpr):  # fmt: skip
    b, at, exists = here(plane, BLOCK)
    L: tl.constexpr = LIT[len(LIT) - 1]
    out += (b * plane + at)[:, None] * ALL
    c = tl.arange(0, LP)[None, :]
    values = _joined(light, light[0], b, plane, at, exists, LIT, LIT_FLAGS, LP)
    values = compressed(tl.load(scale + b) * values).to(out.dtype.element_ty).to(tl.float32) * unit
    tl.store(out + c, values.to(out.dtype.element_ty), mask=exists[:, None] & (c < L))
    if ALL > L:
        c = tl.arange(0, GP)[None, :]
        values = _joined(guides, light[0], b, plane, at, exists, ENDS, FLAGS, GP)  # 0 beyond the last guide
        tl.store(out + L + c, values.to(out.dtype.element_ty), mask=exists[:, None] & (c < ALL - L))


def features(
    light: Sequence[Tensor], guides: Sequence[Tensor], scale: Tensor, dtype: torch.dtype, unit: float, lanes: int
) -> Tensor:
    light, guides = (tuple(x.contiguous() for x in images) for images in (light, guides))
    B, _, H, W = light[0].shape
    scale = scale.expand(B, 1, 1, 1).reshape(B).contiguous()
    lit, ends = ((0, *accumulate(x.shape[1] for x in images)) for images in (light, guides))
    channels = triton.cdiv(lit[-1] + ends[-1], lanes) * lanes
    out = torch.empty(B, channels, H, W, dtype=dtype, device=light[0].device, memory_format=torch.channels_last)
    flags = tuple(x.dtype is torch.bool for x in guides)
    guides = tuple(x.view(torch.uint8) if flag else x for x, flag in zip(guides, flags, strict=True))
    sizes = {"LP": triton.next_power_of_2(lit[-1]), "GP": triton.next_power_of_2(channels - lit[-1]), "ALL": channels}
    _features[grid(B, H * W, PIXELS)](
        light, guides or light, scale, out, H * W, float(unit), LIT=lit, LIT_FLAGS=(False,) * len(light), ENDS=ends,
        FLAGS=flags, BLOCK=PIXELS, **sizes,
    )  # fmt: skip
    return out
