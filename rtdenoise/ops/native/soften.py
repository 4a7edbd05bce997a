"""`soften`, with a coarse image as scratch memory."""

from __future__ import annotations

import torch
from torch import Tensor

from .compiler import library, pointer
from .downsample import POOLS


def soften(composed: Tensor, fine: Tensor, share: Tensor) -> Tensor:
    composed, fine, share = (t.contiguous() for t in (composed, fine, share))
    B, C, H, W = fine.shape
    coarse, out = fine.new_empty(B, C, (H + 1) // 2, (W + 1) // 2), torch.empty_like(fine)
    pointers = map(pointer, (composed, fine, share, coarse, out))
    library("soften", POOL=POOLS["mean"]).soften(*pointers, B, C, H, W, torch.get_num_threads())
    return out
