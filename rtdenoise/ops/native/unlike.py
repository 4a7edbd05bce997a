"""`unlike`, in one pass."""

from __future__ import annotations

from ctypes import c_float

import torch
from torch import Tensor

from ...constants import CUT_ALIKE, DEPTH_TOLERANCE, MIN_NORMAL_COSINE
from .compiler import library, pointer


def unlike(depth: Tensor, normal: Tensor, motion: Tensor, depth_before: Tensor, normal_before: Tensor) -> Tensor:
    images = [x.contiguous() for x in (depth, normal, motion, depth_before, normal_before)]
    B, _, H, W = depth.shape
    counts = torch.empty(B, 3, dtype=torch.int64, device="cpu")
    limits = (c_float(x) for x in (DEPTH_TOLERANCE, MIN_NORMAL_COSINE, CUT_ALIKE**2))
    library("unlike").unlike(*map(pointer, (*images, counts)), B, H, W, *limits, torch.get_num_threads())
    return counts
