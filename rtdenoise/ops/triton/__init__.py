"""Fused ops for CUDA, in Triton. Same names as in `rtdenoise.ops`, whose functions check the arguments and call these
where they apply (`ops.path`). Sums and weights are float32 whatever the logits are stored in.

A program computes `common.BLOCK` neighbouring pixels of one row, all channels at once: tiles are [BLOCK] or [BLOCK,
CP], CP the number of channels filled up to a power of two. With TRITON_INTERPRET=1 the same code runs on the CPU,
slowly.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from .apply_kernel import apply_kernel as apply_kernel
from .look_up import fetch as fetch
from .look_up import reproject as reproject
from .look_up import warp as warp
from .pyramid import compose as compose
from .pyramid import downsample as downsample


def unsupported(op: str, *tensors: Tensor) -> str | None:
    """Why `op` cannot take these arguments, or None. Only `apply_kernel` has gradients here."""
    floats = tensors[:1] if op == "apply_kernel" else tensors
    halves = (torch.float32, torch.bfloat16, torch.float16)
    if any(t.dtype != torch.float32 for t in floats) or tensors[-1].dtype not in halves:
        return f"for float32 images, not {', '.join(str(t.dtype).removeprefix('torch.') for t in tensors)}"
    if op != "apply_kernel" and torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return "it has no gradient"
    image = tensors[0]
    if image.numel() == 0 or image.shape[2] * image.shape[3] >= 2**31 or math.prod(image.shape[:3]) > 65535:
        return f"not for images of {tuple(image.shape)}"
    return None
