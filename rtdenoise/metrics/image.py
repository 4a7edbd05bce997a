"""Errors of one image, over the frame or inside a mask.

Display metrics (PSNR, SSIM, L1, MSE, LDR-FLIP) are taken on the display transform `color.display`, relMSE, SMAPE and
HDR-FLIP on linear radiance times the same `scale`. All functions share the arguments of `psnr`, and raise ValueError
for images, or a mask, of other shapes: torch would broadcast them.

A reference of finitely many samples is noisy itself, and MSE counts its noise as error of the image. The difference
between the two halves of its samples (`reference_half` is the mean of one) estimates that noise; `mse_corrected`
subtracts it.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from skimage.metrics import structural_similarity
from torch import Tensor
from torch.nn import functional as F

from ..color import display, luminance
from ..errors import InputError

WINDOW = 7  # pixels: the side of SSIM's
DARKEST = 2.0**-22  # luminance of a reference that HDR-FLIP finds exposures for; it stops at float32's epsilon, 2⁻²³


def psnr(
    image: Tensor,  # [1, 3, H, W] linear radiance
    reference: Tensor,  # [1, 3, H, W]
    scale: Tensor | float,  # exposure of both (`color.display_exposure`, one for a sequence)
    mask: Tensor | None = None,  # [1, 1, H, W] bool
) -> float:
    """Peak signal-to-noise ratio in dB on the display transform, peak 1. NaN where the mask is empty."""
    return decibels(mse(image, reference, scale, mask))


def mse(image: Tensor, reference: Tensor, scale: Tensor | float, mask: Tensor | None = None) -> float:
    """Mean of (a - r)² on the display transform; in [0, 1]."""
    a, r = displayed(scale, image, reference)
    return masked_mean((a - r).square(), mask)


def mse_corrected(
    image: Tensor,
    reference: Tensor,
    scale: Tensor | float,
    mask: Tensor | None = None,
    *,
    reference_half: Tensor,  # [1, 3, H, W] mean of one half of the reference's samples
) -> float:
    """`mse` minus the error of the reference itself (`reference_mse`): an estimate of the error against the converged
    picture.

    The reference must be independent of the image. The estimate is noisy and can be 0 or negative, in a small mask or
    for an image better than its reference: average it over frames before taking a logarithm.
    """
    return mse(image, reference, scale, mask) - reference_mse(reference, reference_half, scale, mask)


def psnr_corrected(
    image: Tensor,
    reference: Tensor,
    scale: Tensor | float,
    mask: Tensor | None = None,
    *,
    reference_half: Tensor,
) -> float:
    """`mse_corrected` in dB; NaN where that is 0 or negative: the reference is too noisy to tell."""
    return decibels_of_estimate(mse_corrected(image, reference, scale, mask, reference_half=reference_half))


def reference_mse(
    reference: Tensor, reference_half: Tensor, scale: Tensor | float, mask: Tensor | None = None
) -> float:
    """The error of the reference itself against the converged picture, as `mse` counts it.

    The variance of a mean r of two independent halves r₁ and r₂ = 2r - r₁ is E[(r₁ - r₂)²] / 4 (dual buffers: Rousselle
    et al. 2012), here on the display transform D: mean((D(r₁) - D(r₂))²) / 4. Not included is the bias
    D″ · Var(r) / 2 of the nonlinear D(r), which falls with more samples.
    """
    first, second = displayed(scale, reference_half, 2 * reference - reference_half)
    return masked_mean((first - second).square(), mask) / 4


def l1(image: Tensor, reference: Tensor, scale: Tensor | float, mask: Tensor | None = None) -> float:
    """Mean of |a - r| on the display transform; in [0, 1]."""
    a, r = displayed(scale, image, reference)
    return masked_mean((a - r).abs(), mask)


def ssim(image: Tensor, reference: Tensor, scale: Tensor | float, mask: Tensor | None = None) -> float:
    """Structural similarity (Wang et al. 2004; scikit-image, 7×7 window) on the display transform; NaN for
    frames smaller than the window, and where the window of a pixel in the mask has NaN. Raises ValueError for several
    images.
    """
    a, b = map(_channels_last, displayed(scale, image, reference))
    if min(a.shape[:2]) < WINDOW:
        return math.nan
    lost = np.isnan(a) | np.isnan(b)
    a, b = (np.where(lost, 0, x) for x in (a, b))  # scikit-image's running sums would carry NaN to the end of a row
    _, similarity = structural_similarity(a, b, win_size=WINDOW, channel_axis=2, data_range=1.0, full=True)
    reached = F.max_pool2d(torch.from_numpy(lost).permute(2, 0, 1).float(), WINDOW, stride=1, padding=WINDOW // 2) > 0
    similarity = torch.from_numpy(np.ascontiguousarray(similarity)).permute(2, 0, 1)
    return masked_mean(similarity.where(~reached, math.nan)[None], mask)


def relmse(
    image: Tensor,
    reference: Tensor,
    scale: Tensor | float,
    mask: Tensor | None = None,
    reference_half: Tensor | None = None,  # [1, 3, H, W] mean of one half of the reference's samples
) -> float:
    """Mean of (a - r)² / (r² + 0.01) on linear, exposed radiance (Rousselle et al. 2011).

    With one half r₁ of the reference's samples the other is r₂ = 2r - r₁, and (a - r)² becomes (a - r₁)(a - r₂): its
    mean is free of the reference's noise. It can be slightly negative for an image as good as its reference.
    """
    a, r, half = exposed(scale, image, reference, reference if reference_half is None else reference_half)
    return masked_mean((a - half) * (a - (2 * r - half)) / (r.square() + 0.01), mask)


def smape(image: Tensor, reference: Tensor, scale: Tensor | float, mask: Tensor | None = None) -> float:
    """Symmetric mean absolute percentage error, mean of |a - r| / (|a| + |r| + 0.01) on linear, exposed radiance; in
    [0, 1).

    ε = 0.01 (Vogels et al. 2018) keeps black pixels from counting fully.
    """
    a, r = exposed(scale, image, reference)
    return masked_mean((a - r).abs() / (a.abs() + r.abs() + 0.01), mask)


def flip(
    image: Tensor,
    reference: Tensor,
    scale: Tensor | float,
    mask: Tensor | None = None,
    dynamic_range: str = "LDR",  # LDR | HDR
) -> float:
    """Mean of `flip_map`; in [0, 1]."""
    return masked_mean(flip_map(image, reference, scale, dynamic_range), mask)


def flip_map(image: Tensor, reference: Tensor, scale: Tensor | float, dynamic_range: str = "LDR") -> Tensor:
    """The perceived difference when flipping between both, `[1, 1, H, W]` in [0, 1], at 67 pixels per degree; NaN where
    one of them is.

    LDR (Andersson et al. 2020) is taken on the display transform; HDR (Andersson et al. 2021) is the maximum of
    LDR-FLIP over the exposures that FLIP derives from the reference, NaN where it can derive none: the reference is
    black or not finite. Raises InputError where `flip_evaluator` is not installed, ValueError for another dynamic range
    and for several images.
    """
    if dynamic_range not in ("LDR", "HDR"):
        raise ValueError(f"expected dynamic range 'LDR' or 'HDR', got {dynamic_range!r}")
    try:
        import flip_evaluator
    except ImportError:
        raise InputError("metric flip needs flip-evaluator: pip install 'rtdenoise[bench]'") from None
    shown = displayed if dynamic_range == "LDR" else exposed
    r, a = (x.clamp(min=0) for x in shown(scale, reference, image))
    nothing = torch.full((1, 1, *r.shape[2:]), math.nan)
    if dynamic_range == "HDR" and not (r.isfinite().all() and (luminance(r) > DARKEST).any()):
        return nothing  # FLIP would end the process
    r, a = (np.ascontiguousarray(_channels_last(x), np.float32) for x in (r, a))
    error, _, _ = flip_evaluator.evaluate(r, a, dynamic_range, applyMagma=False, computeMeanError=False)
    known = torch.from_numpy(~np.isnan(r + a).any(2))
    return torch.from_numpy(np.ascontiguousarray(error)).permute(2, 0, 1)[None].where(known, nothing)


def displayed(scale: Tensor | float, *images: Tensor) -> list[Tensor]:
    """Images of one shape `[B, 3, H, W]`, `color.display`. Raises ValueError for others."""
    return [display(image, scale) for image in _alike(images)]


def exposed(scale: Tensor | float, *images: Tensor) -> list[Tensor]:
    """Likewise times `scale`."""
    return [image * scale for image in _alike(images)]


def _alike(images: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    if len(shapes := {tuple(image.shape) for image in images}) > 1 or images[0].ndim != 4:
        found = " and ".join(map(str, sorted(shapes)))
        raise ValueError(f"expected images of one shape [1, 3, H, W], got {found}")
    return images


def _channels_last(image: Tensor) -> np.ndarray:
    """`[1, 3, H, W]` as `[H, W, 3]` of float32 or float64, for libraries that compare one image with one. Raises
    ValueError for several."""
    if len(image) != 1:
        raise ValueError(f"expected one image [1, 3, H, W], got {tuple(image.shape)}")
    image = image.to(torch.promote_types(image.dtype, torch.float32))
    return image[0].detach().permute(1, 2, 0).cpu().numpy()


def decibels_of_estimate(mse: float) -> float:
    """`decibels` of a corrected mean square; NaN where that is 0 or negative."""
    return decibels(mse) if mse > 0 else math.nan


def decibels(mse: float) -> float:
    """-10 · log₁₀ of a mean squared error with peak 1; inf where it is 0, NaN where it is NaN."""
    return -10 * math.log10(mse) if mse > 0 else (math.inf if mse == 0 else math.nan)


def masked_mean(error: Tensor, mask: Tensor | None) -> float:
    """Mean of `[1, C, H, W]` over the pixels of `mask` `[1, 1, H, W]`, in float64; NaN where it is empty. Raises
    ValueError for a mask of another shape."""
    if mask is None:
        return error.double().mean().item()
    if mask.shape != error[:, :1].shape:
        raise ValueError(f"expected a mask {tuple(error[:, :1].shape)}, got {tuple(mask.shape)}")
    kept = error.double()[mask.to(error.device).expand_as(error)]
    return kept.mean().item() if kept.numel() else math.nan
