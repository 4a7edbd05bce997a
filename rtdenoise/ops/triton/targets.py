"""Targets of motion vectors, for `warp` and `fetch`."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def clamped_target(motion, x, n):
    """Target of pixel x in a row of n, clamped to the row; a motion that is not finite counts as zero."""
    finite = tl.abs(motion) <= 3.4028235e38  # the greatest float32
    return tl.minimum(tl.maximum(tl.where(finite, motion, 0.0) + x, 0.0), n - 1.0)
