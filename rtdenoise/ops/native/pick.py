"""`pick`, without gradients."""

from __future__ import annotations

from ctypes import byref

import torch
from torch import Tensor

from .compiler import library, pointer
from .logits import constants, layout, readable


def pick(fine: Tensor, coarse: Tensor, share: Tensor, logits: Tensor) -> Tensor:
    images, logits = [t.contiguous() for t in (fine, coarse, share)], readable(logits)
    out, (B, _, H, W) = torch.empty_like(images[0]), fine.shape
    run = library("pick", **constants(fine, logits)).pick
    run(*map(pointer, (*images, logits, out)), B, H, W, byref(layout(logits)), torch.get_num_threads())
    return out
