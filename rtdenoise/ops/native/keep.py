"""`keep`, without gradients."""

from __future__ import annotations

from ctypes import c_float

import torch
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, FAR_AWAY, RECALL_EDGE_SPEED, RECALL_FOOTPRINT_WORDS, RECALL_WORDS
from .compiler import library, pointer


def keep(light: Tensor, depth: Tensor, normal: Tensor, reset: Tensor, motion: Tensor, albedo: Tensor | None) -> Tensor:
    images = [t.contiguous() for t in (light, depth, normal, reset, motion, albedo) if t is not None]
    B, _, H, W = light.shape
    words = RECALL_WORDS if albedo is None else RECALL_FOOTPRINT_WORDS
    kept = torch.empty(B, words, H, W, dtype=torch.int32, device="cpu", memory_format=torch.channels_last)
    inputs = [*map(pointer, images), *[None] * (6 - len(images))]
    tolerances = map(c_float, (DEPTH_TOLERANCE, RECALL_EDGE_SPEED))
    library("keep", FAR_AWAY=FAR_AWAY).keep(*inputs, pointer(kept), B, H, W, *tolerances, torch.get_num_threads())
    return kept
