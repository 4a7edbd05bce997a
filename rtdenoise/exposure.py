"""The brightness of a frame, its noise, and single pixels too bright for it."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from .color import luminance
from .constants import BRIGHTNESS_BLOCK, BRIGHTNESS_SHARE, FIREFLY_LIMIT, MIN_BRIGHTNESS, NOISE_WINDOW, NOISE_WINDOWS
from .ops.block_luminance import block_luminance


def exposure(radiance: Tensor, block: int = BRIGHTNESS_BLOCK) -> Tensor:
    """One over the brightness of a frame, `[B, 3, H, W] -> [B, 1, 1, 1]`, by a statistic that single pixels cannot
    move.

    Brightness is the mean of the block means below their 90th percentile. Blocks, because at 1 spp most pixels of
    indirect light are black and a percentile of pixels says little; the cut, because a firefly then moves one block
    only. Frames darker than `MIN_BRIGHTNESS` count as black and get its exposure.
    """
    means, _ = block_luminance(radiance, block)
    kept = means.sort(dim=1).values[:, : max(1, int(means.shape[1] * BRIGHTNESS_SHARE))]
    return 1 / kept.mean(dim=1).clamp(min=MIN_BRIGHTNESS).reshape(-1, 1, 1, 1)


def noise_level(radiance: Tensor, depth: Tensor) -> Tensor:
    """The noise of a frame, `[B, 3, H, W]` and its depth `[B, 1, H, W]` to `[B, 1, 1, 1]`: the median over windows of
    3 × 3 pixels, all of which hit something, of the variance of their light over the square of its mean; infinite where
    there are none. Most windows hold no edge, so that it falls with the number of samples: from 0.3 to 8 at 1 sample a
    pixel to 0.04 to 0.4 at 64.
    """
    light = radiance.mean(1, keepdim=True)
    if min(light.shape[2:]) < NOISE_WINDOW:
        return torch.full_like(light[..., :1, :1], torch.inf)
    mean, square = (F.avg_pool2d(x, NOISE_WINDOW, NOISE_WINDOWS) for x in (light, light.square()))
    hit = F.max_pool2d(-depth, NOISE_WINDOW, NOISE_WINDOWS) < 0
    count = NOISE_WINDOW**2
    relative = (square / mean.square().clamp(min=1e-30) - 1).clamp(min=0) * count / (count - 1)
    median = torch.where(hit & (mean > 0), relative, torch.nan).flatten(1).nanmedian(1).values
    return median.nan_to_num(nan=torch.inf).view(-1, 1, 1, 1)


def limit_fireflies(radiance: Tensor, limit: float = FIREFLY_LIMIT, block: int = BRIGHTNESS_BLOCK) -> Tensor:
    """Dim single pixels that are far brighter than their neighbours and the rest of the frame, `[B, 3, H, W]`; the hue
    stays.

        bound = limit · max(brightest of the 8 neighbours, k-th brightest block maximum),    k = 2 + ⌊blocks / 50⌋

    in luminance. Several adjacent bright pixels are a light: kept. Bright pixels all over the frame are the noise of a
    heavy-tailed estimator and carry the picture's energy: kept, dimming them would darken it. With fewer than `k`
    blocks that are not black the usual brightness is unknown: kept. Scales with the radiance.
    """
    _, maxima = block_luminance(radiance, block)
    count = min(2 + maxima.shape[1] // 50, maxima.shape[1])
    usual = maxima.topk(count, dim=1).values[:, -1:]
    if radiance.device.type == "cpu" and bool((maxima <= limit * usual).all()):
        return radiance  # no pixel is that bright; on a GPU, looking would mean waiting
    usual, brightness = usual.reshape(-1, 1, 1, 1), luminance(radiance)
    bound = limit * torch.maximum(_brightest_neighbour(brightness), usual)
    cut = (brightness > bound) & (usual > 0)
    return torch.where(cut, radiance * (bound / brightness), radiance)


def _brightest_neighbour(image: Tensor) -> Tensor:
    """Maximum of the 8 pixels around each, `[B, 1, H, W]`, of an image without negative values."""
    sides = F.pad(image, (1, 1, 0, 0))
    beside = torch.maximum(sides[..., :-2], sides[..., 2:])
    rows = F.pad(torch.maximum(beside, image), (0, 0, 1, 1))
    return torch.maximum(beside, torch.maximum(rows[..., :-2, :], rows[..., 2:, :]))
