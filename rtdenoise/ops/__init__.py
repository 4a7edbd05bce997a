"""The kernel-apply operations, with gradients. Each module states its index equation and has it in plain torch, which
is the specification; `native` (CPU) and `triton` (CUDA) hold fused ones of the same names, and `path` chooses.
`features`, `pixels`, `blocks` and `temporal` have what else a step does to whole pictures, fused in the same way.

Image conventions are those of `rtdenoise.frame`: `[B, C, H, W]`, row 0 on top, x right, y down.
"""

from .apply_kernel import apply_kernel
from .path import use
from .pyramid import blend, compose, downsample, pick, upsample
from .reproject import alike, reproject
from .warp import fetch, warp

__all__ = [
    "alike", "apply_kernel", "blend", "compose", "downsample", "fetch", "pick", "reproject", "upsample", "use", "warp",
]  # fmt: skip
