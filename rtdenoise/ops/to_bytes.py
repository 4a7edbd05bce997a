"""Features in bytes, with a step for each channel: what `convolve_bytes` reads of a layer that computes in numbers."""

from __future__ import annotations

import torch
from torch import Tensor

from .dispatch import Fused, Support, falls_back

FUSED = Fused("to_bytes", native=Support(halves=("x",), channels_last=True))
# What is below the point is cut off, so this rounds. A whole number and a half is none in bfloat16 from 128 on: rounded
# to the next one, it would be one too many.
HALF = 0.498


@falls_back
def to_bytes(
    x: Tensor,  # [B, C, H, W] ≥ 0: float32, or bfloat16, in which it computes then
    scale: Tensor,  # [C, 1, 1] > 0: steps of a byte in a unit of x, in the dtype of x
) -> Tensor:  # [B, C, H, W] uint8, channels last
    """The nearest whole number to x · scale, at most 255."""
    last = x.is_contiguous(memory_format=torch.channels_last)
    fits = scale.shape == (x.shape[1], 1, 1) and scale.dtype == x.dtype
    if last and fits and x.dtype != torch.float16 and (run := FUSED(x=x)):
        return run(x, scale)
    steps = torch.addcmul(x.new_tensor(HALF), x, scale)
    return steps.clamp_(max=255).to(torch.uint8, memory_format=torch.channels_last)
