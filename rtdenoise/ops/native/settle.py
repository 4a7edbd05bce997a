"""`settle`, without gradients: the sums of `share_told` by cells, the weighted differences, then the pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import MIX_CELL, SETTLE_BROAD, SETTLE_BROAD_NEW, SETTLE_FAR, SETTLE_FINE, SETTLE_FINE_NEW
from .compiler import library, pointer
from .mix import SUMS, TOLD


def settle(image: Tensor, following: Tensor, noisy: Tensor, alike: Tensor, trusted: Tensor, scale: Tensor) -> Tensor:
    B, _, H, W = image.shape
    given = [x.contiguous() for x in (image, following, noisy, alike, trusted, scale.expand(B, 1, 1, 1))]
    threads = torch.get_num_threads()
    cells = image.new_empty(2, -(-H // MIX_CELL), SUMS, -(-W // MIX_CELL))
    weight, apart, space = (image.new_empty(shape) for shape in ((H, W), (3, H, W), (threads, 3, W + 2)))
    out = torch.empty_like(given[0])
    shares = {"BROAD": SETTLE_BROAD, "FINE": SETTLE_FINE, "BROAD_NEW": SETTLE_BROAD_NEW, "FINE_NEW": SETTLE_FINE_NEW}
    run = library("settle", FAR=SETTLE_FAR, **TOLD, **shares).settle
    run(*map(pointer, (*given, *cells, weight, apart, space, out)), B, H, W, threads)
    return out
