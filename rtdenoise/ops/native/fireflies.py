"""`without_fireflies`: a row at a time."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import DEPTH_TOLERANCE, FIREFLY_ALIKE, MIN_NORMAL_COSINE
from .compiler import library, pointer


def without_fireflies(light: Tensor, depth: Tensor, normal: Tensor, known: Tensor) -> Tensor:
    given, (B, _, H, W) = [x.contiguous() for x in (light, depth, normal, known)], light.shape
    out = torch.empty_like(given[0])
    constants = {"TOLERANCE": DEPTH_TOLERANCE, "COSINE": MIN_NORMAL_COSINE, "LEAST": FIREFLY_ALIKE}
    run = library("fireflies", **constants).without_fireflies
    run(*map(pointer, (*given, out)), B, H, W, torch.get_num_threads())
    return out
