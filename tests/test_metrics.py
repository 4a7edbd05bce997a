"""Metrics against closed forms and scikit-image."""

import math

import numpy as np
import pytest
import torch
from skimage import metrics as skimage_metrics

from rtdenoise.color import compress, display, display_exposure, expand, exposure, luminance, srgb_decode, srgb_encode
from rtdenoise.metrics import psnr, relmse, ssim


@pytest.fixture
def images():
    g = torch.Generator().manual_seed(0)
    reference = torch.rand(1, 3, 40, 30, generator=g)
    return (reference + 0.1 * torch.rand(1, 3, 40, 30, generator=g)).clamp(0, 1), reference


def hwc(image):
    return display(image)[0].permute(1, 2, 0).numpy()


def test_psnr_is_scikit_images(images):
    image, reference = images
    expected = skimage_metrics.peak_signal_noise_ratio(hwc(reference), hwc(image), data_range=1.0)
    assert psnr(image, reference, 1.0) == pytest.approx(expected, abs=1e-4)
    assert psnr(reference, reference, 1.0) == math.inf


def test_ssim_is_scikit_images(images):
    image, reference = images
    expected = skimage_metrics.structural_similarity(hwc(reference), hwc(image), channel_axis=2, data_range=1.0)
    # scikit-image leaves a border out of its mean; the full map does not.
    inner = torch.zeros(1, 1, 40, 30, dtype=torch.bool)
    inner[..., 3:-3, 3:-3] = True
    assert ssim(image, reference, 1.0, inner) == pytest.approx(expected, abs=1e-5)
    assert ssim(reference, reference, 1.0) == pytest.approx(1)
    assert math.isnan(ssim(image[..., :5, :5], reference[..., :5, :5], 1.0))


def test_masks_select_pixels(images):
    image, reference = images
    mask = torch.zeros(1, 1, 40, 30, dtype=torch.bool)
    assert math.isnan(psnr(image, reference, 1.0, mask))
    mask[..., 4, 5] = True
    error = (display(image) - display(reference))[..., 4, 5].square().mean().item()
    assert psnr(image, reference, 1.0, mask) == pytest.approx(-10 * math.log10(error), abs=1e-4)


def test_relmse_of_a_flat_image():
    reference = torch.full((1, 3, 4, 4), 0.5)
    assert relmse(reference * 1.2, reference, 2.0) == pytest.approx(0.2**2 / (1 + 0.01))


def test_half_references_take_the_references_noise_out_of_relmse():
    g = torch.Generator().manual_seed(3)
    truth, noise = torch.full((1, 3, 256, 256), 1.0), 0.1
    halves = [truth + noise * torch.randn(truth.shape, generator=g) for _ in range(2)]
    reference = (halves[0] + halves[1]) / 2
    image = truth + 0.1
    naive = relmse(image, reference, 1.0)
    unbiased = relmse(image, reference, 1.0, reference_half=halves[0])
    assert naive > 0.0145  # 0.1² and the reference's own 0.1²/2
    assert unbiased == pytest.approx(0.01, abs=0.003)  # but for the noise of r² in the denominator


def test_transfer_curves_undo_each_other():
    x = torch.logspace(-6, 4, 50, dtype=torch.float64)
    torch.testing.assert_close(expand(compress(x)), x)
    unit = torch.linspace(0, 1, 101, dtype=torch.float64)
    torch.testing.assert_close(srgb_decode(srgb_encode(unit)), unit)
    assert srgb_encode(torch.tensor(0.18)).item() == pytest.approx(0.4613, abs=1e-4)
    assert luminance(torch.ones(1, 3, 1, 1)).item() == pytest.approx(1)


def test_exposure_is_not_moved_by_one_firefly():
    g = torch.Generator().manual_seed(1)
    radiance = torch.rand(1, 3, 96, 96, generator=g)
    hit = radiance.clone()
    hit[..., 17, 40] = 1e7
    assert exposure(hit).item() == pytest.approx(exposure(radiance).item(), rel=0.01)
    assert exposure(radiance * 1e3).item() == pytest.approx(exposure(radiance).item() / 1e3, rel=1e-5)
    assert np.isfinite(exposure(torch.zeros(1, 3, 8, 8)).item())


def test_display_exposure_brings_the_98th_percentile_to_09():
    values = torch.rand(1, 3, 50, 50) * 7
    assert torch.quantile(values * display_exposure(values), 0.98).item() == pytest.approx(0.9, abs=1e-3)
