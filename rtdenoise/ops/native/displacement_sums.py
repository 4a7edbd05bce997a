"""`displacement_sums`, whose plain twin and declaration are in `rtdenoise.shift.displacement`: in one pass."""

from __future__ import annotations

from ctypes import c_float

import torch
from torch import Tensor

from .compiler import library, pointer


def displacement_sums(*images: Tensor | int | float) -> Tensor:
    *images, cell, stride, tolerance = images
    images = [image.contiguous() for image in images]
    B, _, H, W = images[0].shape
    sums = images[0].new_empty(B, 7, -(-H // cell), -(-W // cell))
    run = library("displacement_sums").displacement_sums
    run(*map(pointer, (*images, sums)), B, H, W, cell, stride, c_float(tolerance), torch.get_num_threads())
    return sums
