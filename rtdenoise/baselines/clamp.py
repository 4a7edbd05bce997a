"""Neighbourhood colour clamping: history is pulled into the range that the current frame shows around the pixel."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F


def clamp_to_neighbourhood(
    history: Tensor,  # [B, C, H, W] reprojected
    current: Tensor,  # [B, C, H, W] the noisy frame
    sigmas: float,  # k, > 0
    window: int = 5,  # side of the square neighbourhood, odd
) -> Tensor:  # [B, C, H, W]
    """`clamp(history, μ - k·σ, μ + k·σ)` a channel (the paper, §3.1, after Salvi's variance clipping).

    μ and σ are mean and standard deviation of `current` in the window around each pixel, as far as it lies inside the
    image. The noisier the frame, the wider the range: with k·σ greater than the difference between occluder and
    background a ghost passes unharmed.
    """
    pool = {"kernel_size": window, "stride": 1, "padding": window // 2, "count_include_pad": False}
    mean = F.avg_pool2d(current, **pool)
    deviation = (F.avg_pool2d(current.square(), **pool) - mean.square()).clamp(min=0).sqrt()
    return history.clamp(mean - sigmas * deviation, mean + sigmas * deviation)
