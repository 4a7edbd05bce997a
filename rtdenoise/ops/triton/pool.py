"""D of eq. 4 at one pixel."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def pooled(image, y, x, exists, H, W, MAXIMUM: tl.constexpr):
    """D at the coarse pixel (y, x) of one plane; at an odd border, of the pixels that exist."""
    i, j = tl.minimum(2 * y + 1, H - 1), tl.minimum(2 * x + 1, W - 1)  # a cell that is cut off repeats its pixels
    p = tl.load(image + 2 * y * W + 2 * x, mask=exists, other=0.0)
    q = tl.load(image + 2 * y * W + j, mask=exists, other=0.0)
    r = tl.load(image + i * W + 2 * x, mask=exists, other=0.0)
    s = tl.load(image + i * W + j, mask=exists, other=0.0)
    return tl.maximum(tl.maximum(p, q), tl.maximum(r, s)) if MAXIMUM else (p + q + r + s) * 0.25
