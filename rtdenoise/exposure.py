"""The brightness of a frame, its noise, and single pixels too bright for it."""

from __future__ import annotations

import torch
from torch import Tensor

from .constants import BRIGHTNESS_BLOCK, FIREFLY_LIMIT, NOISE_WINDOW
from .ops.block_luminance import block_luminance
from .ops.dim import dim
from .ops.ranks import exposure_of, kth_greatest, median
from .ops.window_noise import window_noise


def exposure(radiance: Tensor) -> Tensor:
    """One over the brightness of a frame, `[B, 3, H, W] -> [B, 1, 1, 1]`, by a statistic that single pixels cannot
    move.

    Brightness is the mean of the block means below their 90th percentile. Blocks, because at 1 spp most pixels of
    indirect light are black and a percentile of pixels says little; the cut, because a firefly then moves one block
    only. Where more than half of the blocks are black, as around something small before nothing, only as many of these
    count as there are others. Frames darker than `MIN_BRIGHTNESS` count as black and get its exposure.
    """
    means, _ = block_luminance(radiance, BRIGHTNESS_BLOCK)
    return exposure_of(means)


def noise_level(radiance: Tensor, depth: Tensor) -> Tensor:
    """The noise of a frame, `[B, 3, H, W]` and its depth `[B, 1, H, W]` to `[B, 1, 1, 1]`: the median over windows of
    3 × 3 pixels, all of which hit something, of the variance of their light over the square of its mean; infinite where
    there are none. Most windows hold no edge, so that it falls with the number of samples: from 0.3 to 8 at 1 sample a
    pixel to 0.04 to 0.4 at 64.
    """
    if min(radiance.shape[2:]) < NOISE_WINDOW:
        return torch.full_like(radiance[:, :1, :1, :1], torch.inf)
    return median(window_noise(radiance, depth))


def limit_fireflies(radiance: Tensor) -> Tensor:
    """Dim single pixels that are far brighter than their neighbours and the rest of the frame, `[B, 3, H, W]`; the hue
    stays.

        bound = limit · max(brightest of the 8 neighbours, k-th brightest block maximum),    k = 2 + ⌊blocks / 50⌋

    in luminance, with the limit `FIREFLY_LIMIT`. Several adjacent bright pixels are a light: kept. Bright pixels all
    over the frame are the noise of a heavy-tailed estimator and carry the picture's energy: kept, dimming them would
    darken it. With fewer than `k` blocks that are not black the usual brightness is unknown: kept. Scales with the
    radiance.
    """
    _, maxima = block_luminance(radiance, BRIGHTNESS_BLOCK)
    count = min(2 + maxima.shape[1] // 50, maxima.shape[1])
    usual = kth_greatest(maxima, count)
    if radiance.device.type == "cpu" and bool((maxima <= FIREFLY_LIMIT * usual).all()):
        return radiance  # no pixel is that bright; on a GPU, looking would mean waiting
    return dim(radiance, usual, FIREFLY_LIMIT)
