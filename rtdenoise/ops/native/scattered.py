"""`scattered`: crowded samples, lone ones and their extremes along rows, then along columns."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, SCATTERED_ALIKE, SCATTERED_APART, SCATTERED_REACH
from .compiler import library, pointer


def scattered(depth: Tensor) -> Tensor:
    depth, (B, _, H, W) = depth.contiguous(), depth.shape
    rows, out = depth.new_empty(2, B, 2, H, W).unbind()
    crowded = torch.empty_like(depth)
    constants = {"ALIKE": SCATTERED_ALIKE, "REACH": SCATTERED_REACH, "APART": SCATTERED_APART}
    run = library("scattered", TOLERANCE=DEPTH_TOLERANCE, **constants).scattered
    run(*map(pointer, (depth, crowded, rows, out)), B, H, W, torch.get_num_threads())
    return out
