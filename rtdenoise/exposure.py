"""How bright a frame is, and which single pixels are brighter than anything explains."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from .color import luminance
from .ops.block_luminance import block_luminance


def exposure(radiance: Tensor, block: int = 8) -> Tensor:
    """One over the brightness of a frame, `[B, 3, H, W] -> [B, 1, 1, 1]`, by a statistic that single pixels cannot
    move.

    Brightness is the mean of the block means below their 90th percentile. Block means, because at 1 spp most pixels of
    indirect light are black, so that no percentile of the pixels themselves says how bright the frame is; the cut,
    because one firefly moves its own block only. Frames darker than 1e-8 count as black and get the exposure of that
    brightness.
    """
    means, _ = block_luminance(radiance, block)
    kept = means.sort(dim=1).values[:, : max(1, int(means.shape[1] * 0.9))]
    return 1 / kept.mean(dim=1).clamp(min=1e-8).reshape(-1, 1, 1, 1)


def limit_fireflies(radiance: Tensor, limit: float = 5.0, block: int = 8) -> Tensor:
    """Cut single pixels that nothing around them and nothing else in the frame explains, `[B, 3, H, W]`; the hue stays.

        bound = limit · max(brightest of the 8 neighbours, k-th brightest block maximum),    k = 2 + ⌊blocks / 50⌋

    in luminance. What is bright in several adjacent pixels is a light and is kept; what is bright all over the frame is
    the noise of a heavy-tailed estimator, whose energy is the picture's, and is kept: cutting it would darken. A frame
    with fewer than `k` blocks that are not black has no measure of what is usual, and is kept. Scales with the
    radiance.
    """
    _, maxima = block_luminance(radiance, block)
    count = min(2 + maxima.shape[1] // 50, maxima.shape[1])
    usual = maxima.topk(count, dim=1).values[:, -1:]
    if radiance.device.type == "cpu" and bool((maxima <= limit * usual).all()):
        return radiance  # nothing is that bright; a GPU would have to be waited for to know
    usual, brightness = usual.reshape(-1, 1, 1, 1), luminance(radiance)
    bound = limit * torch.maximum(_brightest_neighbour(brightness), usual)
    cut = (brightness > bound) & (usual > 0)
    return torch.where(cut, radiance * (bound / brightness), radiance)


def _brightest_neighbour(image: Tensor) -> Tensor:
    """The greatest of the 8 pixels around each, `[B, 1, H, W]`, of an image that is nowhere negative."""
    sides = F.pad(image, (1, 1, 0, 0))
    beside = torch.maximum(sides[..., :-2], sides[..., 2:])
    rows = F.pad(torch.maximum(beside, image), (0, 0, 1, 1))
    return torch.maximum(beside, torch.maximum(rows[..., :-2, :], rows[..., 2:, :]))
