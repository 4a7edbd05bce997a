"""The denoiser as OpenGL 4.3 compute shaders, for any GPU, without torch: `Pipeline` denoises whole frames, the
operations are twins of those in `rtdenoise.ops`."""

from .clock import Clock
from .context import GpuArray, create_context, default_context, storage_limit
from .ops import (
    alike,
    apply_kernel,
    attend_blocks,
    blend,
    compose,
    downsample,
    fetch,
    pick,
    reproject,
    soften,
    upsample,
    warp,
)
from .pipeline import Pipeline
from .program import program
from .source import ShaderError, expand
from .state import History

__all__ = [
    "Clock", "GpuArray", "History", "Pipeline", "ShaderError", "alike", "apply_kernel", "attend_blocks", "blend",
    "compose", "create_context", "default_context", "downsample", "expand", "fetch", "pick", "program", "reproject",
    "soften", "storage_limit", "upsample", "warp",
]  # fmt: skip
