"""Transfer curves beside their inverses, luminance, exposure and the display transform."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def compress(radiance: Tensor) -> Tensor:
    """`log(1 + x)`: what the network sees and the loss is taken in, so that fireflies do not rule. Inverse:
    `expand`."""
    return torch.log1p(radiance)


def expand(compressed: Tensor) -> Tensor:
    """Inverse of `compress`."""
    return torch.expm1(compressed)


def srgb_encode(linear: Tensor) -> Tensor:
    """The sRGB transfer curve (IEC 61966-2-1), [0, 1] to [0, 1]. Inverse: `srgb_decode`."""
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clamp(min=0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: Tensor) -> Tensor:
    """Inverse of `srgb_encode`."""
    return torch.where(encoded <= 0.04045, encoded / 12.92, ((encoded.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4)


def luminance(rgb: Tensor) -> Tensor:
    """Rec. 709 luminance, `[B, 3, H, W] -> [B, 1, H, W]`."""
    r, g, b = rgb.unbind(1)
    return (0.2126 * r + 0.7152 * g + 0.0722 * b).unsqueeze(1)


def albedo_divisor(albedo: Tensor, depth: Tensor, least: float = 0.1, share: float = 0.25) -> Tensor:
    """What radiance is divided by to take textures out of it, `[B, 3, H, W]`, and multiplied by in the end.

    The albedo, but never below `least`, nor below `share` of its brightest channel; 1 where nothing was hit (`depth` is
    0). Not all light takes the albedo's colour: what mirrors or gloss send back, divided by a deep red, would be a
    glaring cyan, which a filter would spread beyond the red. Continuous in the albedo: dark textures that dither around
    a threshold stay smooth.
    """
    floor = (share * albedo.amax(dim=1, keepdim=True)).clamp(min=least)
    return torch.where(depth > 0, torch.maximum(albedo, floor), 1.0)


def exposure(radiance: Tensor, block: int = 8) -> Tensor:
    """One over the brightness of a frame, `[B, 3, H, W] -> [B, 1, 1, 1]`, by a statistic that single pixels cannot
    move.

    Brightness is the mean of the block means below their 90th percentile. Block means, because at 1 spp most pixels of
    indirect light are black, so that no percentile of the pixels themselves says how bright the frame is; the cut,
    because one firefly moves its own block only. Frames darker than 1e-8 count as black and get the exposure of that
    brightness.
    """
    means = F.avg_pool2d(luminance(radiance), block, ceil_mode=True, count_include_pad=False).flatten(1)
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
    brightness = luminance(radiance)
    maxima = F.max_pool2d(brightness, block, ceil_mode=True).flatten(1)
    count = min(2 + maxima.shape[1] // 50, maxima.shape[1])
    usual = maxima.topk(count, dim=1).values[:, -1:]
    if radiance.device.type == "cpu" and bool((maxima <= limit * usual).all()):
        return radiance  # nothing is that bright; a GPU would have to be waited for to know
    usual = usual.reshape(-1, 1, 1, 1)
    bound = limit * torch.maximum(_brightest_neighbour(brightness), usual)
    cut = (brightness > bound) & (usual > 0)
    return torch.where(cut, radiance * (bound / brightness), radiance)


def _brightest_neighbour(image: Tensor) -> Tensor:
    """The greatest of the 8 pixels around each, `[B, 1, H, W]`, of an image that is nowhere negative."""
    sides = F.pad(image, (1, 1, 0, 0))
    beside = torch.maximum(sides[..., :-2], sides[..., 2:])
    rows = F.pad(torch.maximum(beside, image), (0, 0, 1, 1))
    return torch.maximum(beside, torch.maximum(rows[..., :-2, :], rows[..., 2:, :]))


def display_exposure(reference: Tensor) -> Tensor:
    """Scalar that brings the 98th percentile of the reference to 0.9, for pictures and display metrics."""
    values = reference.flatten().float()
    return 0.9 / torch.quantile(values[:: max(1, values.numel() // 1_000_000)], 0.98).clamp(min=1e-8)


def display(radiance: Tensor, scale: Tensor | float = 1.0) -> Tensor:
    """What a screen shows: exposed by `scale`, clipped to [0, 1], sRGB-encoded."""
    return srgb_encode((radiance * scale).clamp(0, 1))
