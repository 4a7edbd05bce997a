"""`retextured`: sums over cells, then the pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import MOVED_LEAST, MOVED_MOST, RETEXTURED_LEAST, RETEXTURED_MOST, TURNED_CELL
from .compiler import library, pointer

SUMS, ROWS = 4, 8  # as in retextured.c


def retextured(albedo: Tensor, before: Tensor, found: Tensor) -> Tensor:
    images = albedo.contiguous(), before.contiguous(), found.contiguous()
    B, _, H, W = albedo.shape
    threads = torch.get_num_threads()
    cells = albedo.new_empty(B, -(-H // TURNED_CELL), SUMS, -(-W // TURNED_CELL))
    space, out = albedo.new_empty(threads, ROWS, W), albedo.new_empty(B, 1, H, W)
    bounds = {"LEAST": RETEXTURED_LEAST, "MOST": RETEXTURED_MOST, "MOVED_LEAST": MOVED_LEAST, "MOVED_MOST": MOVED_MOST}
    run = library("retextured", CELL=TURNED_CELL, **bounds).retextured
    run(*map(pointer, (*images, out, cells, space)), B, H, W, threads)
    return out
