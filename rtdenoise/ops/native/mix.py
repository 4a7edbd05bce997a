"""`mix`, without gradients: the sums of `share_told` by cells, then the pixels."""

from __future__ import annotations

from ctypes import c_float

import torch
from torch import Tensor

from ...constants import MIX_CELL, MIX_DARK, MIX_FAR, MIX_LARGEST, MIX_NOISE, MIX_TELLS, MIX_UNCOVERED
from .compiler import library, pointer

SUMS = 3  # as in told.h
TOLD = {"CELL": MIX_CELL, "DARK": MIX_DARK, "LARGEST": MIX_LARGEST, "NOISE": MIX_NOISE}  # what it needs


def mix(
    first: Tensor,
    other: Tensor,
    scale: Tensor,
    trust: Tensor,
    shares: tuple[float, float, float],
    before: Tensor | None,
    held: Tensor | None,
    noisy: Tensor | None,
    tells: Tensor | None,
    depth: Tensor | None,
    word: Tensor | None,
) -> Tensor:
    B, _, H, W = first.shape
    word = None if word is None else word.float().expand(B, 1, 1, 1)
    images = first, other, scale.expand(B, 1, 1, 1), trust, before, held, noisy, tells, depth, word
    images = [x if x is None else x.contiguous() for x in images]
    threads = torch.get_num_threads()
    cells = first.new_empty(2, -(-H // MIX_CELL), SUMS, -(-W // MIX_CELL))
    space, out = first.new_empty(threads, SUMS + 1, W), torch.empty_like(images[0])
    given = {"BEFORE": int(before is not None), "NOISY": int(noisy is not None)}
    run = library("mix", FAR=MIX_FAR, TELLS=MIX_TELLS, UNCOVERED=MIX_UNCOVERED, **TOLD, **given).mix
    run(*map(pointer, (*images, cells[0], cells[1], space, out)), B, H, W, *map(c_float, shares), threads)
    return out
