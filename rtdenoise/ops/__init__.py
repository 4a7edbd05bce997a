"""The kernel-apply operations, with gradients. Each module states its index equation and has it in plain torch, which
is the specification; `native` (CPU) and `triton` (CUDA) hold fused ones of the same names, and `path` chooses.

Image conventions are those of `rtdenoise.frame`: `[B, C, H, W]`, row 0 on top, x right, y down.
"""

from .apply_kernel import apply_kernel
from .features import features
from .layout import whole
from .path import use
from .pixels import accumulate, demodulate, modulate
from .pyramid import blend, compose, downsample, upsample
from .reproject import alike, reproject
from .warp import fetch, warp

__all__ = [
    "accumulate",
    "alike",
    "apply_kernel",
    "blend",
    "compose",
    "demodulate",
    "downsample",
    "features",
    "fetch",
    "modulate",
    "reproject",
    "upsample",
    "use",
    "warp",
    "whole",
]
