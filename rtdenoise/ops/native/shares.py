"""`shares`: the sigmoid of logits by cells."""

from __future__ import annotations

from ctypes import byref

import torch
from torch import Tensor

from .compiler import library, pointer
from .logits import CODES, layout, readable


def shares(logits: Tensor, size: tuple[int, int]) -> Tensor:
    logits, (B, _, _, N) = readable(logits), logits.shape[:4]
    out = torch.empty(B, N, *size, dtype=torch.float32, device="cpu")
    run = library("shares", N=N, LOGIT=CODES[logits.dtype]).shares
    run(pointer(logits), pointer(out), B, *size, byref(layout(logits)), torch.get_num_threads())
    return out
