"""`features`, channels last: planes are compressed, converted and transposed in one pass."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import flat_grid, of_images, place_flat
from .curve import compressed

PIXELS = 128  # of a program


@triton.jit
def _features(images, scale, out, plane, unit, ENDS: tl.constexpr, FLAGS: tl.constexpr, LIGHT: tl.constexpr,
              ALL: tl.constexpr, CP: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    """The k-th image is channels ENDS[k] to ENDS[k + 1], of bytes where FLAGS[k]. Addresses are chosen first, so that
    one load reads all that are of floats, and one store writes a pixel. Channels beyond the last image are 0."""
    b, at, exists = place_flat(plane, BLOCK)
    c = tl.arange(0, CP)[None, :]
    number, source = c < 0, images[0] + 0 * c
    for k in tl.static_range(len(FLAGS)):
        if not FLAGS[k]:
            inside = (c >= ENDS[k]) & (c < ENDS[k + 1])
            source = tl.where(inside, images[k] + (b * (ENDS[k + 1] - ENDS[k]) + c - ENDS[k]) * plane, source)
            number = number | inside
    values = tl.load(source + at[:, None], mask=exists[:, None] & number, other=0.0)
    for k in tl.static_range(len(FLAGS)):
        if FLAGS[k]:
            flags = tl.load(images[k] + b * plane + at, mask=exists, other=0).to(tl.float32)
            values = tl.where(c == ENDS[k], flags[:, None], values)
    lit = compressed(tl.load(scale + b) * tl.where(c < LIGHT, values, 0.0))
    lit = lit.to(out.dtype.element_ty).to(tl.float32) * unit
    values = tl.where(c < LIGHT, lit, values).to(out.dtype.element_ty)
    tl.store(out + (b * plane + at)[:, None] * ALL + c, values, mask=exists[:, None] & (c < ALL))


def features(
    light: Sequence[Tensor], guides: Sequence[Tensor], scale: Tensor, dtype: torch.dtype, unit: float, lanes: int
) -> Tensor:
    several = (x.float() if x.dtype is torch.bool and x.shape[1] > 1 else x for x in guides)  # flags have one channel
    images = tuple(x.contiguous() for x in (*light, *several))
    B, _, H, W = images[0].shape
    ends = 0, *accumulate(x.shape[1] for x in images)
    channels = triton.cdiv(ends[-1], lanes) * lanes
    out = torch.empty(B, channels, H, W, dtype=dtype, device=images[0].device, memory_format=torch.channels_last)
    flags = tuple(x.dtype is torch.bool for x in images)
    images = tuple(x.view(torch.uint8) if flag else x for x, flag in zip(images, flags, strict=True))
    sizes = {"LIGHT": ends[len(light)], "ALL": channels, "CP": triton.next_power_of_2(channels), "BLOCK": PIXELS}
    _features[flat_grid(B, H * W, PIXELS)](
        images, of_images(scale, B), out, H * W, float(unit), ENDS=ends, FLAGS=flags, **sizes
    )
    return out
