"""Luminance at pixels (`color.luminance`)."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def luminance(radiance, plane, exists, red, green, blue):
    """That of pixels whose red is at `radiance`, with Rec. 709's weights."""
    r = tl.load(radiance, mask=exists, other=0.0)
    g = tl.load(radiance + plane, mask=exists, other=0.0)
    b = tl.load(radiance + 2 * plane, mask=exists, other=0.0)
    return red * r + green * g + blue * b
