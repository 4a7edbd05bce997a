"""Image errors, over the frame or inside a mask. Display metrics see what a screen shows; relMSE sees linear
radiance."""

from __future__ import annotations

import math

import numpy as np
import torch
from skimage.metrics import structural_similarity
from torch import Tensor

from .color import display


def psnr(
    image: Tensor,  # [1, 3, H, W] linear radiance
    reference: Tensor,  # [1, 3, H, W]
    scale: Tensor | float,  # exposure of both (`color.display_exposure`, one for a sequence)
    mask: Tensor | None = None,  # [1, 1, H, W] bool
) -> float:
    """Peak signal-to-noise ratio in dB on the display transform, peak 1. NaN where the mask is empty."""
    error = (display(image, scale) - display(reference, scale)).square()
    mean = _mean(error, mask)
    return -10 * math.log10(mean) if mean > 0 else (math.inf if mean == 0 else math.nan)


def ssim(image: Tensor, reference: Tensor, scale: Tensor | float, mask: Tensor | None = None) -> float:
    """Structural similarity (Wang et al. 2004; scikit-image, 7×7 window) on the display transform, arguments as in
    `psnr`.

    Frames smaller than the window have none: NaN.
    """
    a, b = (display(x, scale)[0].permute(1, 2, 0).cpu().numpy() for x in (image, reference))
    if min(a.shape[:2]) < 7:
        return math.nan
    _, similarity = structural_similarity(a, b, channel_axis=2, data_range=1.0, full=True)
    return _mean(torch.from_numpy(np.ascontiguousarray(similarity)).permute(2, 0, 1)[None], mask)


def relmse(
    image: Tensor,
    reference: Tensor,
    scale: Tensor | float,
    mask: Tensor | None = None,
    reference_half: Tensor | None = None,  # [1, 3, H, W] mean of one half of the reference's samples
) -> float:
    """Mean of (a - r)² / (r² + 0.01) on linear, exposed radiance (Rousselle et al. 2011), arguments as in `psnr`.

    With one half r₁ of the reference's samples the other is r₂ = 2r - r₁, and (a - r)² becomes (a - r₁)(a - r₂): its
    mean does not contain the reference's own noise. It can be slightly negative for an image as good as its reference.
    """
    a, r = image * scale, reference * scale
    half = r if reference_half is None else reference_half * scale
    return _mean((a - half) * (a - (2 * r - half)) / (r.square() + 0.01), mask)


def _mean(error: Tensor, mask: Tensor | None) -> float:
    if mask is None:
        return error.double().mean().item()
    kept = error.double()[mask.to(error.device).expand_as(error)]
    return kept.mean().item() if kept.numel() else math.nan
