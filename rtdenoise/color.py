"""Transfer curves beside their inverses, luminance, exposure and the display transform. The display transform takes
numpy arrays as well as tensors; nothing here imports torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .constants import GLOSS, LUMINANCE_WEIGHTS

if TYPE_CHECKING:
    from torch import Tensor

    Image = Tensor | np.ndarray


def compress(radiance: Tensor) -> Tensor:
    """`log(1 + x)`: the domain of the network's input and of the loss, where fireflies do not dominate. Inverse:
    `expand`."""
    return radiance.log1p()


def expand(compressed: Tensor) -> Tensor:
    """Inverse of `compress`."""
    return compressed.expm1()


def srgb_encode(linear: Image) -> Image:
    """The sRGB transfer curve (IEC 61966-2-1), [0, 1] to [0, 1]. Inverse: `srgb_decode`."""
    return _where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear.clip(min=0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: Image) -> Image:
    """Inverse of `srgb_encode`."""
    return _where(encoded <= 0.04045, encoded / 12.92, ((encoded.clip(min=0.04045) + 0.055) / 1.055) ** 2.4)


def luminance(rgb: Tensor) -> Tensor:
    """Rec. 709 luminance, `[B, 3, H, W] -> [B, 1, H, W]`."""
    (red, green, blue), (r, g, b) = LUMINANCE_WEIGHTS, rgb.unbind(1)
    return (red * r + green * g + blue * b).unsqueeze(1)


def albedo_divisor(albedo: Tensor, depth: Tensor) -> Tensor:
    """The divisor that takes textures out of radiance, and the factor that gives them back, `[B, 3, H, W]`.

    The albedo plus `GLOSS`; 1 where nothing was hit (`depth` is 0). Every surface reflects some light that does not
    take its colour. Divided by a deep red alone that light would be a glaring cyan, which a filter would spread beyond
    the red; with a least divisor in place of the sum, a texture darker than that would not be taken out at all
    (docs/notes/divisor.md compares both). Linear in the albedo: the mean of divisors is the divisor of the mean.
    """
    return (albedo + GLOSS).where(depth > 0, 1.0)


def display_exposure(reference: Image) -> Tensor | float:
    """Scalar that brings the 98th percentile of the reference to 0.9, for pictures and display metrics."""
    values = reference.flatten()
    values = values[:: sampled_apart(len(values))]
    if isinstance(values, np.ndarray):
        return 0.9 / max(float(np.quantile(values, 0.98)), 1e-8)
    return 0.9 / values.float().quantile(0.98).clamp(min=1e-8)


def sampled_apart(values: int) -> int:
    """The step between those of so many values that `display_exposure` looks at."""
    return max(1, values // 1_000_000)


def display(radiance: Image, scale: Tensor | float = 1.0) -> Image:
    """The picture on a screen: exposed by `scale`, clipped to [0, 1], sRGB-encoded."""
    return srgb_encode((radiance * scale).clip(0, 1))


def _where(condition: Image, a: Image, b: Image) -> Image:
    return np.where(condition, a, b) if isinstance(a, np.ndarray) else a.where(condition, b)
