"""The combiner that needs no training: shrink each pixel's residual by how much of it is error of the denoiser.

With two independent halves y₁, y₂ of the noisy samples, y = (y₁ + y₂) / 2, and a denoised z,

    E = mean (z - y₁)(z - y₂)       estimates the squared error of z: the halves' noises are independent of each other
    V = mean (y₁ - y₂)² / 4         estimates the variance of y
    image = z + w (y - z),    w = E / (E + V)

with means over a neighbourhood and the channels. This w has the least squared error if the noises of y and z are
uncorrelated (James and Stein 1961). z was made from y, so E is a little too small and w errs towards z.

Without halves, E and V come from the residuals in the neighbourhood alone: their squared mean, less the variance that
chance gives a mean, and their variance. An error of z that changes within the neighbourhood counts as noise of y there.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from torch.nn import functional as F

from ..models.combiner import Combined, Window, comparable


@dataclass(frozen=True)
class Shrinkage:
    """Corrects each frame by itself; `combine` as that of `models.Combiner`."""

    side: int = 5  # of the neighbourhood in pixels, odd

    def combine(self, window: Window, half: Tensor | None = None) -> Combined:
        """Correct the middle frame of a window. `half`: the mean of one half of its noisy samples, [B, 3, H, W]."""
        place = len(window.frames) // 2
        noisy, estimate = comparable(window.frames[place].radiance, window.estimates[place])
        residual = noisy - estimate
        error, variance = self._of_halves(noisy, half, estimate) if half is not None else self._of_residuals(residual)
        error = error.clamp(min=0)
        correction = residual * (error / (error + variance).clamp(min=1e-30))
        image = (window.estimates[place].where(window.estimates[place].isfinite(), estimate) + correction).clamp(min=0)
        return Combined(image, correction.abs().mean(1, keepdim=True))

    def _of_halves(self, noisy: Tensor, half: Tensor, estimate: Tensor) -> tuple[Tensor, Tensor]:
        other = 2 * noisy - half
        return self._mean((estimate - half) * (estimate - other)), self._mean((half - other).square()) / 4

    def _of_residuals(self, residual: Tensor) -> tuple[Tensor, Tensor]:
        count = self.side**2
        box = lambda image: F.avg_pool2d(image, self.side, 1, self.side // 2, count_include_pad=False)  # noqa: E731
        mean, square = box(residual), box(residual.square())
        variance = (square - mean.square()).mean(1, keepdim=True) * count / (count - 1)
        return mean.square().mean(1, keepdim=True) - variance / count, variance

    def _mean(self, image: Tensor) -> Tensor:
        """Over the neighbourhood and the channels, `[B, 1, H, W]`."""
        image = image.mean(1, keepdim=True)
        return F.avg_pool2d(image, self.side, 1, self.side // 2, count_include_pad=False)
