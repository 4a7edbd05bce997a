"""`compose`, with a coarse image as scratch memory."""

from __future__ import annotations

import torch
from torch import Tensor

from .compiler import library, pointer
from .downsample import POOLS


def compose(fine: Tensor, coarse: Tensor, alpha: Tensor, pool: str) -> Tensor:
    fine, coarse, alpha = (t.contiguous() for t in (fine, coarse, alpha))
    change, out = torch.empty_like(coarse), torch.empty_like(fine)
    pointers = map(pointer, (fine, coarse, alpha, change, out))
    library("compose", POOL=POOLS[pool]).compose(*pointers, *fine.shape, torch.get_num_threads())
    return out
