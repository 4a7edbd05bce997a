"""The noise of windows of pixels, for that of a frame."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import NOISE_WINDOW, NOISE_WINDOWS
from .dispatch import Fused, Support, falls_back

IMAGES = {"radiance": (3,), "depth": (1,)}
FUSED = Fused("window_noise", triton=Support(channels=IMAGES))


@falls_back
def window_noise(
    radiance: Tensor,  # [B, 3, H, W] ≥ 0, H and W at least NOISE_WINDOW
    depth: Tensor,  # [B, 1, H, W], 0 where nothing was hit
) -> Tensor:  # [B, N]
    """The variance of light over the square of its mean in windows of `NOISE_WINDOW`² pixels, one every `NOISE_WINDOWS`
    pixels along either axis; NaN where not all pixels hit something, or all are black."""
    if run := FUSED(radiance=radiance, depth=depth):
        return run(radiance, depth)
    light = radiance.mean(1, keepdim=True)
    mean, square = (F.avg_pool2d(x, NOISE_WINDOW, NOISE_WINDOWS) for x in (light, light.square()))
    hit = F.max_pool2d(-depth, NOISE_WINDOW, NOISE_WINDOWS) < 0
    count = NOISE_WINDOW**2
    relative = (square / mean.square().clamp(min=1e-30) - 1).clamp(min=0) * count / (count - 1)
    return torch.where(hit & (mean > 0), relative, torch.nan).flatten(1)
