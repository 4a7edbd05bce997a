"""`fetch`, without gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from .compiler import library, pointer


def fetch(image: Tensor, motion: Tensor) -> Tensor:
    image, motion = image.contiguous(), motion.contiguous()
    out, (B, C, H, W) = torch.empty_like(image), image.shape
    library("fetch", C=C).fetch(*map(pointer, (image, motion, out)), B, H, W, torch.get_num_threads())
    return out
