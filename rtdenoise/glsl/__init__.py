"""The kernel-apply operations as OpenGL 4.3 compute shaders, for any GPU: twins of `rtdenoise.ops` without torch."""

from .context import GpuArray, create_context, default_context, storage_limit
from .ops import apply_kernel, blend, compose, downsample, fetch, upsample, warp
from .program import ShaderError, program

__all__ = [
    "GpuArray", "ShaderError", "apply_kernel", "blend", "compose", "create_context", "default_context", "downsample",
    "fetch", "program", "storage_limit", "upsample", "warp",
]  # fmt: skip
