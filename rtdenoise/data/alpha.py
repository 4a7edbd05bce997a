"""Alpha of few samples a pixel, smoothed along the edges of the denoised picture. numpy only.

At one sample a pixel alpha is 0 or 1, while the denoised picture has smooth edges: over another background they would
be jagged, with dark or bright fringes. Before nothing, radiance is alpha times that of the surface. So alpha is, near
each pixel, a linear function of the picture's colours, and a guided filter (He, Sun and Tang, "Guided Image Filtering",
2010) finds it: what remains has the edges of the picture (docs/notes/alpha.md).
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .around import around, gaussian, shifted

FEW = 8  # values that alpha of fewer samples takes; from as many samples on it is better as rendered
WINDOW, SMOOTH = (2, 0.7), (1, 0.5)  # radius and standard deviation in pixels: of the fit, and of its coefficients
RIDGE = 0.15  # of the mean square of the colours: how much less a fit follows them


def denoise_alpha(
    alpha: np.ndarray,  # [H, W] in [0, 1]
    picture: np.ndarray,  # [H, W, 3] denoised radiance, premultiplied: 0 where alpha is
) -> np.ndarray:  # [H, W] float32
    """Alpha of few samples a pixel with the edges of the denoised picture: `[H, W]` float32 in [0, 1].

    `alpha` is `[H, W]` as rendered, `picture` `[H, W, 3]` denoised radiance, multiplied by alpha as renderers do. In
    windows with Gaussian weights around each pixel

        alpha ≈ k · picture + b,    k = (cov(picture) + RIDGE |mean(picture)|²)⁻¹ cov(picture, alpha)

    and the result is that with the means of k and b around. Where alpha is the same all around it stays to the bit. So
    it does where it takes more values than fewer than 8 samples a pixel give, or is no coverage: beyond [0, 1], or not
    finite. Where the picture is not finite it counts as black. Raises InputError for arrays of other shapes.
    """
    alpha, picture = np.asarray(alpha), np.asarray(picture)
    if alpha.ndim != 2 or picture.shape != (*alpha.shape, 3):
        raise InputError(f"denoise_alpha: expected alpha [H, W] and picture [H, W, 3], got {alpha.shape} and "
                         f"{picture.shape}")  # fmt: skip
    out = alpha.astype(np.float32)
    if not is_noisy(alpha):
        return out
    picture = np.where(np.isfinite(picture), picture, 0)
    fitted = _varies(out, WINDOW[0])
    slope, base = np.zeros((*alpha.shape, 3)), out.astype(np.float64)
    slope[fitted], base[fitted] = _fit(out, picture, fitted)
    place = np.nonzero(_varies(fitted, SMOOTH[0]) | fitted)
    values = (around(slope, place, SMOOTH[0]) * picture[place][:, None]).sum(-1) + around(base, place, SMOOTH[0])
    out[place] = (values * gaussian(*SMOOTH)).sum(1).clip(0, 1)
    return out


def is_noisy(alpha: np.ndarray) -> bool:
    """Whether alpha is a coverage of fewer than FEW samples a pixel, and not the same everywhere."""
    values = np.unique(alpha)
    return 1 < len(values) <= FEW and bool(values[0] >= 0 and values[-1] <= 1)


def _fit(alpha: np.ndarray, picture: np.ndarray, where: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """k `[N, 3]` and b `[N]` of the pixels `where` `[H, W]`."""
    place, weights = np.nonzero(where), gaussian(*WINDOW)
    colors, values = around(picture, place, WINDOW[0]), around(alpha, place, WINDOW[0])
    mean, level = np.einsum("w,nwc->nc", weights, colors), values @ weights
    apart = colors - mean[:, None]
    weighted = (weights[:, None] * apart).transpose(0, 2, 1)
    ridge = RIDGE * np.square(mean).sum(1) + np.finfo(np.float64).tiny
    along = weighted @ (values - level[:, None])[..., None]
    slope = np.linalg.solve(weighted @ apart + ridge[:, None, None] * np.eye(3), along)[..., 0]
    return slope, level - (slope * mean).sum(1)


def _varies(image: np.ndarray, radius: int) -> np.ndarray:
    """Where the values within `radius` pixels of an image `[H, W]` are not all the same, `[H, W]` bool."""
    steps = np.argwhere(np.ones((2 * radius + 1,) * 2)) - radius
    return np.logical_or.reduce([there != image for there in shifted(image, steps, radius)])
