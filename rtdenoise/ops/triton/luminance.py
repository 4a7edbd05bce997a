"""Luminance. Ops that compare it with that of another compile with `enable_fp_fusion=False`: it is then rounded as in
`color.luminance`, so that a pixel is as bright in one op as in another."""

from __future__ import annotations

import triton
import triton.language as tl

from ...constants import LUMINANCE_WEIGHTS

RED, GREEN, BLUE = (tl.constexpr(weight) for weight in LUMINANCE_WEIGHTS)


@triton.jit
def luminance(radiance, plane, inside):
    """Of the pixels at the pointers `radiance`, with their other channels `plane` apart; 0 where not `inside`."""
    red = tl.load(radiance, mask=inside, other=0.0)
    green = tl.load(radiance + plane, mask=inside, other=0.0)
    return red * RED + green * GREEN + tl.load(radiance + 2 * plane, mask=inside, other=0.0) * BLUE
