"""The combiner that needs no training: scale each pixel's residual by the denoiser's estimated share of the error.

With two independent halves y₁, y₂ of the noisy samples, y = (y₁ + y₂) / 2, and a denoised z,

    E = mean (z - y₁)(z - y₂)       estimates the squared error of z: the noises of the halves are independent
    V = mean (y₁ - y₂)² / 4         estimates the variance of y
    image = z + w (y - z),    w = E' / (E' + V),    E' = max(E - t V, 0)

with means over a neighbourhood and the channels. With t = 0 this w has the least squared error if the noises of y and z
are uncorrelated (James and Stein 1961) and E is known. E is an estimate as noisy as V is large, and z was made from y.
So E must exceed a share t of V before it counts.

Without halves, E and V come from the residuals in the neighbourhood alone: E is their squared mean less the variance of
that mean, V their variance. An error of z that changes within the neighbourhood counts as noise of y there.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from torch.nn import functional as F

from ..models.combiner import Combined, Window, comparable


@dataclass(frozen=True)
class Shrinkage:
    """Corrects each frame by itself; `combine` as that of `models.Combiner`.

    The defaults were chosen on 28 cells of training clips at 4, 16 and 32 spp: the least error with at most 3 cells of
    28 above 1.02 of z's from 16 spp on, and none without halves.
    """

    side: int = 13  # of the neighbourhood in pixels, odd
    threshold: float = 0.5  # t
    side_alone: int = 9  # the same without halves
    threshold_alone: float = 0.1

    def combine(self, window: Window, half: Tensor | None = None) -> Combined:
        """Correct the middle frame of a window. `half`: the mean of one half of its noisy samples, [B, 3, H, W]."""
        place = len(window.frames) // 2
        noisy, estimate = comparable(window.frames[place].radiance, window.estimates[place])
        residual = noisy - estimate
        if half is None:
            (error, variance), threshold = self._of_residuals(residual), self.threshold_alone
        else:
            (error, variance), threshold = self._of_halves(noisy, half, estimate), self.threshold
        error = (error - threshold * variance).clamp(min=0)
        correction = residual * (error / (error + variance).clamp(min=1e-30))
        image = (window.estimates[place].where(window.estimates[place].isfinite(), estimate) + correction).clamp(min=0)
        return Combined(image, correction.abs().mean(1, keepdim=True))

    def _of_halves(self, noisy: Tensor, half: Tensor, estimate: Tensor) -> tuple[Tensor, Tensor]:
        other = 2 * noisy - half
        error, variance = (estimate - half) * (estimate - other), (half - other).square() / 4
        return tuple(_mean(x.mean(1, keepdim=True), self.side) for x in (error, variance))

    def _of_residuals(self, residual: Tensor) -> tuple[Tensor, Tensor]:
        count = self.side_alone**2
        mean, square = _mean(residual, self.side_alone), _mean(residual.square(), self.side_alone)
        variance = (square - mean.square()).mean(1, keepdim=True) * count / (count - 1)
        return mean.square().mean(1, keepdim=True) - variance / count, variance


def _mean(image: Tensor, side: int) -> Tensor:
    """Over `side` × `side` pixels, of those inside the image."""
    return F.avg_pool2d(image, side, stride=1, padding=side // 2, count_include_pad=False)
