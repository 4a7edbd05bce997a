"""`expand_within`, without gradients: extremes by cells, then the pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import AROUND_CELL
from .compiler import library, pointer


def expand_within(compressed: Tensor, first: Tensor, other: Tensor) -> Tensor:
    B, C, H, W = compressed.shape
    images = [x.contiguous() for x in (compressed, first, other)]
    least, most = compressed.new_empty(2, B * C, -(-H // AROUND_CELL), -(-W // AROUND_CELL)).unbind()
    threads = torch.get_num_threads()
    space, out = compressed.new_empty(threads, 2, W), torch.empty_like(images[0])
    run = library("around", CELL=AROUND_CELL).expand_within
    run(*map(pointer, (*images, least, most, space, out)), B * C, H, W, threads)
    return out
