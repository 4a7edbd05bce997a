"""`block_luminance`, in one pass."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import LUMINANCE_WEIGHTS
from ..block_luminance import MAX_BLOCK
from .compiler import library, pointer

CONSTANTS = dict(zip(("RED", "GREEN", "BLUE"), LUMINANCE_WEIGHTS, strict=True), MAX_BLOCK=MAX_BLOCK)


def block_luminance(radiance: Tensor, block: int) -> tuple[Tensor, Tensor]:
    radiance = radiance.contiguous()
    B, _, H, W = radiance.shape
    means, maxima = radiance.new_empty(2, B, -(-H // block) * -(-W // block))
    run = library("block_luminance", **CONSTANTS).block_luminance
    run(*map(pointer, (radiance, means, maxima)), B, H, W, block, torch.get_num_threads())
    return means, maxima
