"""`recall` and `keep`, without gradients."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import CDLL, c_float

import torch
from torch import Tensor

from ...constants import (
    DEPTH_TOLERANCE,
    FAR_AWAY,
    GLOSS,
    MIN_NORMAL_COSINE,
    RECALL_ALIKE,
    RECALL_CELL,
    RECALL_CHANGED,
    RECALL_EDGE_SPEED,
    RECALL_JOINED,
    RECALL_ROUNDING,
    RECALL_WHITE,
    RECALL_WIDE_ALIKE,
    RECALL_WIDE_CHANGED,
)
from .compiler import library, pointer, pointers

FOUND, SUMS, OF_CELL, BLOCK = 4, 6, 5, 256  # as in recall.c
WORDS = 3  # likewise, found of a pixel in each kept frame


def recall(
    light: Tensor,
    motion: Tensor,
    depth: Tensor,
    normal: Tensor,
    recent: Sequence[Tensor],
    uncovered: Tensor | None,
    misplaced: Tensor | None,
    lone: Tensor | None,
) -> tuple[Tensor, ...]:
    now = [t.contiguous() for t in (light, motion, depth, normal)]
    words = min(t.shape[1] for t in recent)  # frames of a history that another network began may have more
    recent = [t[:, :words].contiguous(memory_format=torch.channels_last) for t in recent]
    B, _, H, W = light.shape
    footprint = uncovered is not None
    threads, K = torch.get_num_threads(), len(recent)
    masks = [mask if mask is None else mask.contiguous() for mask in (uncovered, lone)]
    less = light.new_zeros(B) if misplaced is None else misplaced.expand(B, 1, 1, 1).contiguous()
    results = [light.new_empty(B, channels, H, W) for channels in ((3, 1, 9, 1) if footprint else (3, 1))]
    found = light.new_empty(threads, FOUND, K, WORDS, RECALL_CELL, BLOCK, dtype=torch.int32)
    cells = light.new_empty(threads, SUMS, K, OF_CELL, BLOCK // RECALL_CELL)
    kept = pointers(image for images in zip(*recent, strict=True) for image in images)
    outputs = [*map(pointer, results), *[None] * (4 - len(results))]
    tests = RECALL_ALIKE, RECALL_CHANGED, RECALL_WIDE_ALIKE, RECALL_WIDE_CHANGED, RECALL_WHITE, RECALL_JOINED
    tolerances = map(c_float, (DEPTH_TOLERANCE, MIN_NORMAL_COSINE, *tests, RECALL_EDGE_SPEED))
    _compiled().recall(
        *map(pointer, now),
        *(mask if mask is None else pointer(mask) for mask in masks),
        pointer(less),
        kept,
        *outputs,
        pointer(found),
        pointer(cells),
        K,
        B,
        H,
        W,
        words,
        *tolerances,
        threads,
    )
    return tuple(results)


def _compiled() -> CDLL:
    return library("recall", CELL=RECALL_CELL, ROUNDING=RECALL_ROUNDING, FAR_AWAY=FAR_AWAY, GLOSS=GLOSS)
