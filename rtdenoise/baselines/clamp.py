"""Neighbourhood colour clamping: history is clamped to the range of the current frame around the pixel."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F


def clamp_to_neighbourhood(
    history: Tensor,  # [B, C, H, W] reprojected
    current: Tensor,  # [B, C, H, W] the noisy frame
    sigmas: float,  # k, > 0
    window: int = 5,  # side of the square neighbourhood, odd
) -> Tensor:  # [B, C, H, W]
    """`clamp(history, μ - k·σ, μ + k·σ)` in each channel (the paper, §3.1, after Salvi's variance clipping).

    μ and σ are mean and standard deviation of `current` over the part of the window around each pixel that lies inside
    the image. Noise widens the range: where k·σ exceeds the difference between occluder and background, a ghost stays.
    """
    pool = {"kernel_size": window, "stride": 1, "padding": window // 2, "count_include_pad": False}
    mean = F.avg_pool2d(current, **pool)
    deviation = (F.avg_pool2d(current.square(), **pool) - mean.square()).clamp(min=0).sqrt()
    return history.clamp(mean - sigmas * deviation, mean + sigmas * deviation)
