"""`recall` and `keep`, without gradients."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import CDLL, c_float, c_void_p

import torch
from torch import Tensor

from ...constants import (
    DEPTH_TOLERANCE,
    FAR_AWAY,
    MIN_NORMAL_COSINE,
    RECALL_ALIKE,
    RECALL_CELL,
    RECALL_CHANGED,
    RECALL_WORDS,
)
from .compiler import library, pointer

FOUND, SUMS = 2, 3  # rows of cells, as in recall.c


def recall(
    light: Tensor, motion: Tensor, depth: Tensor, normal: Tensor, recent: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    now = [t.contiguous() for t in (light, motion, depth, normal)]
    recent = [t.contiguous() for t in recent]
    B, _, H, W = light.shape
    threads, K = torch.get_num_threads(), len(recent)
    mean, count = torch.empty_like(now[0]), torch.empty_like(now[2])
    found = torch.empty(threads, FOUND, K, 3, RECALL_CELL, W, dtype=torch.int32)
    cells = torch.empty(threads, SUMS, K, 4, -(-W // RECALL_CELL))
    kept = (c_void_p * (B * K))(*(image.data_ptr() for images in zip(*recent, strict=True) for image in images))
    tolerances = map(c_float, (DEPTH_TOLERANCE, MIN_NORMAL_COSINE, RECALL_ALIKE, RECALL_CHANGED))
    _compiled().recall(
        *map(pointer, now), kept, *map(pointer, (mean, count, found, cells)), K, B, H, W, *tolerances, threads
    )
    return mean, count


def keep(light: Tensor, depth: Tensor, normal: Tensor, reset: Tensor, motion: Tensor) -> Tensor:
    images = [t.contiguous() for t in (light, depth, normal, reset, motion)]
    B, _, H, W = light.shape
    kept = torch.empty(B, RECALL_WORDS, H, W, dtype=torch.int32)
    _compiled().keep(*map(pointer, images), pointer(kept), B, H, W, torch.get_num_threads())
    return kept


def _compiled() -> CDLL:
    return library("recall", CELL=RECALL_CELL, FAR_AWAY=FAR_AWAY)
