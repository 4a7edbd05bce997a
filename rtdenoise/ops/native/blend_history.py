"""`blend_history`: `forward` of apply_kernel.c, which fills gaps in its image and blends its result."""

from __future__ import annotations

from torch import Tensor

from .apply_kernel import forward
from .logits import readable


def blend_history(spatial: Tensor, past: Tensor, seen: Tensor, logits: Tensor, alpha: Tensor) -> Tensor:
    blended = [t.contiguous() for t in (seen, spatial, alpha)]
    return forward(past.contiguous(), readable(logits), None, *blended)
