"""`turned`: sums over cells, then the pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import TURNED_ANGLE, TURNED_CELL, TURNED_NOISE
from .compiler import library, pointer

SUMS = 5  # as in turned.c


def turned(normal: Tensor, before: Tensor) -> Tensor:
    images = normal.contiguous(), before.contiguous()
    B, _, H, W = normal.shape
    threads = torch.get_num_threads()
    cells = normal.new_empty(B, -(-H // TURNED_CELL), SUMS, -(-W // TURNED_CELL))
    space, out = normal.new_empty(threads, SUMS, W), normal.new_empty(B, 1, H, W)
    run = library("turned", CELL=TURNED_CELL, NOISE=TURNED_NOISE, ANGLE=TURNED_ANGLE).turned
    run(*map(pointer, (*images, out, cells, space)), B, H, W, threads)
    return out
