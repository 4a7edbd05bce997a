"""`downsample`: one plane after the other."""

from __future__ import annotations

import torch
from torch import Tensor

from .compiler import library, pointer

POOLS = {"mean": 0, "max": 1}  # POOL of pool.h


def downsample(image: Tensor, pool: str) -> Tensor:
    image = image.contiguous()
    B, C, H, W = image.shape
    out = image.new_empty(B, C, (H + 1) // 2, (W + 1) // 2)
    library("downsample", POOL=POOLS[pool]).downsample(
        pointer(image), pointer(out), B * C, H, W, torch.get_num_threads()
    )
    return out
