"""Blend weights from a head's logits."""

from __future__ import annotations

from torch import Tensor

from .dispatch import Fused, Support, falls_back
from .logits import whole

SUPPORT = Support(halves=("logits",))
FUSED = Fused("shares", native=SUPPORT, triton=SUPPORT)


@falls_back
def shares(
    logits: Tensor,  # [B, 2, 2, N, ⌈H/2⌉, ⌈W/2⌉] by cells (`apply_kernel`): float32, bfloat16 or float16
    size: tuple[int, int],  # (H, W)
) -> Tensor:  # [B, N, H, W] float32 in [0, 1]
    """Sigmoid of logits by cells: N blend weights for each pixel."""
    if run := FUSED(logits=logits):
        return run(logits, size)
    return whole(logits)[:, :, : size[0], : size[1]].float().sigmoid()
