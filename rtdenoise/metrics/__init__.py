"""Errors of an image (`image`) and of a sequence (`video`)."""

from .image import (
    flip,
    flip_map,
    l1,
    mse,
    mse_corrected,
    psnr,
    psnr_corrected,
    reference_mse,
    relmse,
    smape,
    ssim,
)
from .video import fovvideovdp, ghost_length, recent_masks, temporal_relmae, tmse_corrected, tpsnr, tpsnr_corrected

__all__ = [
    "flip", "flip_map", "fovvideovdp", "ghost_length", "l1", "mse", "mse_corrected", "psnr", "psnr_corrected",
    "recent_masks", "reference_mse", "relmse", "smape", "ssim", "temporal_relmae", "tmse_corrected",
    "tpsnr", "tpsnr_corrected",
]  # fmt: skip
