"""`gain`: sums over cells, then two sizes of squares; `relit_`: the cells whose light is another."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import RELIT_CELL, RELIT_DARKER, RELIT_FROM, RELIT_MOST, RELIT_ROUNDING, RELIT_WHOLE
from .compiler import library, pointer

SUMS = 6  # as in relit.c


def gain(before: Tensor, now: Tensor, found: Tensor) -> Tensor:
    images = before.contiguous(), now.contiguous(), found.contiguous()
    B, _, H, W = now.shape
    threads, rows, columns = torch.get_num_threads(), -(-H // RELIT_CELL), -(-W // RELIT_CELL)
    h, w = -(-rows // 2), -(-columns // 2)
    out, cells = now.new_empty(B, 3, rows, columns), now.new_empty(B, rows, SUMS, columns)
    quarters, space = now.new_empty(B, h, SUMS, w), now.new_empty(threads, SUMS, W)
    first, second = now.new_empty(B, -(-h // 2), -(-w // 2), 3), now.new_empty(B, h, w, 3)
    _library().gain(*map(pointer, (*images, out, cells, quarters, first, second, space)), B, H, W, threads)
    return out


def relit_(image: Tensor, gain: Tensor) -> Tensor:
    _library().relit(*map(pointer, (image, gain.contiguous())), *image.shape, torch.get_num_threads())
    return image


def _library():
    bounds = {"DARKER": RELIT_DARKER, "FROM": RELIT_FROM, "WHOLE": RELIT_WHOLE, "MOST": RELIT_MOST}
    return library("relit", CELL=RELIT_CELL, ROUNDING=RELIT_ROUNDING, **bounds)
