"""Targets of motion vectors."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def clamped_target(motion, x, n):
    """Target of pixel x in a row of n, clamped to the row; a motion that is not finite counts as zero."""
    finite = tl.abs(motion) <= 3.4028235e38  # the greatest float32
    return tl.minimum(tl.maximum(tl.where(finite, motion, 0.0) + x, 0.0), n - 1.0)


@triton.jit
def on_screen(u, v, H, W):
    """Whether a target lies on the image (`motion.on_screen`); one that is no number does not."""
    return (u >= -0.5) & (u <= W - 0.5) & (v >= -0.5) & (v <= H - 0.5)
