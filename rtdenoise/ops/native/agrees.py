"""`agrees`: sums over cells, then the pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import (
    AGREES_PATIENCE,
    RECALL_ALIKE,
    RECALL_CELL,
    RECALL_CHANGED,
    RECALL_ROUNDING,
    RECALL_WIDE_ALIKE,
    RECALL_WIDE_CHANGED,
)
from .compiler import library, pointer

SUMS = 4  # as in agrees.c
TESTS = {
    "ALIKE": RECALL_ALIKE, "CHANGED": RECALL_CHANGED, "WIDE_ALIKE": RECALL_WIDE_ALIKE,
    "WIDE_CHANGED": RECALL_WIDE_CHANGED, "ROUNDING": RECALL_ROUNDING, "PATIENCE": AGREES_PATIENCE,
}  # fmt: skip


def agrees(light: Tensor, mean: Tensor, found: Tensor) -> Tensor:
    images = light.contiguous(), mean.contiguous(), found.contiguous()
    B, _, H, W = light.shape
    threads = torch.get_num_threads()
    cells = light.new_empty(B, -(-H // RECALL_CELL), SUMS, -(-W // RECALL_CELL))
    space, out = light.new_empty(threads, SUMS, W), light.new_empty(B, 1, H, W)
    run = library("agrees", CELL=RECALL_CELL, **TESTS).agrees
    run(*map(pointer, (*images, out, cells, space)), B, H, W, threads)
    return out
