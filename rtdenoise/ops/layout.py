"""How logits lie in memory: what the fused kernels, which are handed pointers and strides, have to know."""

from __future__ import annotations

from torch import Tensor


def rows(logits: Tensor) -> Tensor:
    """With rows evenly apart; planes, channels last and slices of their channels are taken as they are."""
    return logits if logits.shape[2] == 1 or logits.stride(2) == logits.shape[3] * step(logits) else logits.contiguous()


def step(logits: Tensor) -> int:
    """Values from one pixel to the next. torch may give an axis of one pixel any stride."""
    return logits.stride(3) if logits.shape[3] > 1 else logits.stride(2) if logits.shape[2] > 1 else 1
