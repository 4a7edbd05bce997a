"""2×2 max pooling of features."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor
from torch.nn import functional as F

from .dispatch import Fused, Support, falls_back

SUPPORT = Support(halves=("x",), channels_last=True)
FUSED = Fused("max_pool", native=replace(SUPPORT, bytes=("whole",)), triton=SUPPORT)


@falls_back
def max_pool(x: Tensor) -> Tensor:
    """`[B, C, H, W]`, H and W even, to `[B, C, H/2, W/2]`. Without gradients by two `maximum`s, rows first: on a CPU
    they are vectorised in every layout, torch's own pooling is not in channels last. With gradients by `F.max_pool2d`:
    its backward is vectorised, that of `maximum` is not."""
    if x.requires_grad:
        return F.max_pool2d(x, 2)
    even = x.shape[2] % 2 == x.shape[3] % 2 == 0  # torch says what does not fit
    given = {"whole" if x.dtype is torch.uint8 else "x": x}
    if even and x.is_contiguous(memory_format=torch.channels_last) and (run := FUSED(**given)):
        return run(x)
    x = torch.maximum(x[:, :, 0::2], x[:, :, 1::2])
    return torch.maximum(x[..., 0::2], x[..., 1::2])
