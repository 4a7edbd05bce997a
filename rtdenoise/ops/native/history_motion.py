"""`history_motion`, whose plain twin and declaration are in `rtdenoise.splat`: one pass over the motion vectors."""

from __future__ import annotations

from ctypes import c_float

import torch
from torch import Tensor

from .compiler import library, pointer


def history_motion(motion: Tensor, motion_next: Tensor, threshold: float) -> tuple[Tensor, Tensor, Tensor]:
    motion, motion_next = motion.contiguous(), motion_next.contiguous()
    B, _, H, W = motion.shape
    out, (seen, uncovered) = torch.empty_like(motion), motion.new_empty(2, B, 1, H, W, dtype=torch.bool)
    pointers = map(pointer, (motion, motion_next, out, seen, uncovered))
    library("history_motion").history_motion(*pointers, B, H, W, c_float(threshold), torch.get_num_threads())
    return out, seen, uncovered
