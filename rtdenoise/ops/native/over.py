"""`over_and_coverage`, without gradients."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_float

import torch
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, FAR_AWAY, GLOSS, OVER_APART, OVER_LIGHT, OVER_SPEED, RECALL_SAME
from .compiler import library, planes, pointer, pointers


def over_and_coverage(
    seen: Tensor, now: Sequence[Tensor], motion: Tensor, depth: Tensor, recent: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    seen, *now = (t.contiguous() for t in (seen, *now))
    where = [t.contiguous() for t in (motion, depth)]
    recent = [t.contiguous(memory_format=torch.channels_last) for t in recent]
    B, _, H, W = seen.shape
    threads, K = torch.get_num_threads(), len(recent)
    kept = pointers(image for images in zip(*recent, strict=True) for image in images)
    out, found = torch.empty_like(seen), seen.new_empty(threads, W, dtype=torch.uint8)
    coverage = seen.new_zeros(B, 3, H, W)
    constants = map(c_float, (OVER_APART, OVER_SPEED, OVER_LIGHT, RECALL_SAME))
    run = library("over", FAR_AWAY=FAR_AWAY, GLOSS=GLOSS, TOLERANCE=DEPTH_TOLERANCE).over
    arrays = pointer(seen), planes(now), *map(pointer, where), kept, *map(pointer, (out, coverage, found))
    run(*arrays, K, B, H, W, *constants, threads)
    return out, coverage
