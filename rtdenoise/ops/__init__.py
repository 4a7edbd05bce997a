"""The kernel-apply operations: plain torch with gradients. Each module states its index equation and is its
specification.

Image conventions are those of `rtdenoise.frame`: `[B, C, H, W]`, row 0 on top, x right, y down.
"""

from .apply_kernel import apply_kernel
from .pyramid import blend, compose, downsample, upsample
from .reproject import alike, reproject
from .warp import fetch, warp

__all__ = ["alike", "apply_kernel", "blend", "compose", "downsample", "fetch", "reproject", "upsample", "warp"]
