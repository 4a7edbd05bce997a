"""Metrics of one image against closed forms, scikit-image and the publications' own formulas; transfer curves."""

import math
import subprocess
import sys

import numpy as np
import pytest
import torch
from skimage import metrics as skimage_metrics

from rtdenoise.color import compress, display, display_exposure, expand, luminance, srgb_decode, srgb_encode
from rtdenoise.errors import InputError
from rtdenoise.exposure import exposure, limit_fireflies
from rtdenoise.metrics import (
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
)  # fmt: skip


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


def test_ssim_is_nan_where_its_windows_have_nan(images):
    """Not in all that is to the right of it, and below."""
    image, reference = images[0].clone(), images[1]
    near, far = torch.zeros(2, 1, 1, 40, 30, dtype=torch.bool)
    near[..., 13, 7], far[..., 14:, :], far[..., 8:] = True, True, True
    expected = ssim(image, reference, 1.0, far), ssim(reference, image, 1.0, far)
    image[0, 1, 10, 4] = math.nan
    assert (ssim(image, reference, 1.0, far), ssim(reference, image, 1.0, far)) == pytest.approx(expected, rel=1e-6)
    assert math.isnan(ssim(image, reference, 1.0, near)) and math.isnan(ssim(image, reference, 1.0))
    only = torch.zeros(1, 1, 40, 30, dtype=torch.bool)
    only[..., 14, 7] = True
    assert math.isfinite(ssim(image, reference, 1.0, only))


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_metrics_take_half_floats(images, dtype):
    image, reference = images
    for metric in (psnr, ssim, flip, relmse, smape, l1):
        expected = metric(image, reference, 1.0)
        assert metric(image.to(dtype), reference.to(dtype), 1.0) == pytest.approx(expected, rel=0.02)


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


@pytest.fixture
def noisy_reference():
    """(image, truth, reference, half): an image whose error is smaller than the noise of its reference."""
    g = torch.Generator().manual_seed(7)
    truth = torch.rand(1, 3, 256, 256, generator=g) * 0.6 + 0.2
    image = truth + 0.01 * torch.randn(truth.shape, generator=g)
    halves = [truth + 0.03 * torch.randn(truth.shape, generator=g) for _ in range(2)]
    return image, truth, (halves[0] + halves[1]) / 2, halves[0]


@pytest.mark.parametrize("masked", [False, True])
def test_corrected_mse_is_the_error_against_the_truth(noisy_reference, masked):
    image, truth, reference, half = noisy_reference
    mask = torch.zeros(1, 1, 256, 256, dtype=torch.bool)
    mask[..., 40:120, 30:150] = True
    mask = mask if masked else None
    true, naive = mse(image, truth, 1.0, mask), mse(image, reference, 1.0, mask)
    corrected = mse_corrected(image, reference, 1.0, mask, reference_half=half)
    pixels = (display(image) - display(reference)).square() - (display(half) - display(2 * reference - half)) ** 2 / 4
    pixels = pixels[mask.expand_as(pixels)] if masked else pixels
    standard_error = (pixels.std() / math.sqrt(pixels.numel())).item()
    # The bias of the display curve remains: below 1 % of the references' error here.
    assert abs(corrected - true) < 3 * standard_error + 0.01 * (naive - true)
    assert naive - true > 20 * standard_error and naive > 5 * true
    own = mse(reference, truth, 1.0, mask)
    assert reference_mse(reference, half, 1.0, mask) == pytest.approx(own, rel=0.03)
    decibels = psnr_corrected(image, reference, 1.0, mask, reference_half=half)
    assert decibels == pytest.approx(-10 * math.log10(corrected)) and decibels > psnr(image, reference, 1.0, mask) + 7


def test_corrected_psnr_is_nan_where_the_reference_cannot_tell(noisy_reference):
    _, _, reference, half = noisy_reference
    assert mse_corrected(reference, reference, 1.0, reference_half=half) < 0  # not independent: beyond what there is
    assert math.isnan(psnr_corrected(reference, reference, 1.0, reference_half=half))
    nothing = torch.zeros(1, 1, 256, 256, dtype=torch.bool)
    assert math.isnan(psnr_corrected(reference, reference, 1.0, nothing, reference_half=half))


def test_mse_and_l1_are_those_of_the_display_transform(images):
    image, reference = images
    expected = skimage_metrics.mean_squared_error(hwc(reference), hwc(image))
    assert mse(image, reference, 1.0) == pytest.approx(expected, rel=1e-5)
    assert psnr(image, reference, 1.0) == pytest.approx(-10 * math.log10(expected), abs=1e-4)
    assert l1(image, reference, 1.0) == pytest.approx(np.abs(hwc(reference) - hwc(image)).mean(), rel=1e-5)


def test_smape_of_flat_images():
    one = torch.ones(1, 3, 4, 4)
    assert smape(one * 3, one, 2.0) == pytest.approx(4 / 8.01)
    assert smape(one, one * 3, 2.0) == pytest.approx(4 / 8.01)
    assert smape(one * 0, one * 0, 1.0) == 0


# FLIP's constants (Andersson et al. 2020): linear sRGB to XYZ, white point, and how colour differences are mapped.
XYZ = np.array([
    [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
    [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
    [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
])  # fmt: skip
POWER, CUT, MAPPED = 0.7, 0.4, 0.95


def flip_of_flat(reference, test):
    """LDR-FLIP between two flat images of linear RGB: its filters keep them, and there are no features."""

    def hunt(rgb):
        x = XYZ @ np.asarray(rgb, float) / XYZ.sum(axis=1)
        f = np.where(x > (6 / 29) ** 3, np.cbrt(x), x / (3 * (6 / 29) ** 2) + 4 / 29)
        lightness = 116 * f[1] - 16
        return lightness, 0.01 * lightness * 500 * (f[0] - f[1]), 0.01 * lightness * 200 * (f[1] - f[2])

    def hyab(p, q):
        (l1, a1, b1), (l2, a2, b2) = hunt(p), hunt(q)
        return (abs(l1 - l2) + math.hypot(a1 - a2, b1 - b2)) ** POWER

    error, greatest = hyab(reference, test), hyab((0, 1, 0), (0, 0, 1))
    knee = CUT * greatest
    return error / knee * MAPPED if error < knee else MAPPED + (error - knee) / (greatest - knee) * (1 - MAPPED)


def coloured(rgb, side=32):
    return torch.tensor(rgb, dtype=torch.float32).reshape(1, 3, 1, 1).expand(1, 3, side, side).contiguous()


@pytest.mark.parametrize(
    ("reference", "test"),
    [((0.2, 0.2, 0.2), (0.3, 0.3, 0.3)), ((0.8, 0.1, 0.1), (0.1, 0.5, 0.3)), ((0, 0, 0), (1, 1, 1))],
)
def test_ldr_flip_of_flat_images_is_the_closed_form(reference, test):
    assert flip(coloured(test), coloured(reference), 1.0) == pytest.approx(flip_of_flat(reference, test), abs=2e-3)


def test_ldr_flip_of_blue_for_green_is_1_and_of_equals_0(images):
    assert flip(coloured((0.0, 0.0, 1.0)), coloured((0.0, 1.0, 0.0)), 1.0) == pytest.approx(1, abs=1e-3)
    assert flip(images[0], images[0], 1.0) == 0


def test_hdr_flip_is_the_greatest_ldr_flip_over_exposures():
    import flip_evaluator

    g = torch.Generator().manual_seed(5)
    reference = torch.empty(1, 3, 24, 24).exponential_(generator=g) * 2
    image = reference * torch.rand(1, 1, 24, 24, generator=g).mul(0.5).add(0.75)
    r, a = (x[0].permute(1, 2, 0).contiguous().numpy() for x in (reference, image))
    _, _, used = flip_evaluator.evaluate(r, a, "HDR", applyMagma=False)
    assert used["tonemapper"].lower() == "aces"

    def aces(x):  # Narkowicz' fit with the exposure scale that FLIP folds into it
        x = np.maximum(x, 0) * 0.6
        return np.clip((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14), 0, 1).astype(np.float32)

    expected = np.zeros((24, 24, 1), np.float32)
    for exposure_ in np.linspace(used["startExposure"], used["stopExposure"], used["numExposures"]):
        exposed = (aces(x * 2.0**exposure_) for x in (r, a))
        error, _, _ = flip_evaluator.evaluate(*exposed, "LDR", inputsRGB=False, applyMagma=False)
        expected = np.maximum(expected, error)
    result = flip_map(image, reference, 1.0, "HDR")[0].permute(1, 2, 0)
    np.testing.assert_allclose(result, expected, atol=2e-3)
    assert flip(image, reference, 1.0, dynamic_range="HDR") == pytest.approx(expected.mean(), abs=1e-3)


def test_hdr_flip_without_an_exposure_is_nan():
    script = """if True:
        import torch
        from rtdenoise.metrics import flip
        for brightest in (0.0, 1e-7, float("inf"), float("nan")):
            black = torch.zeros(1, 3, 8, 8)
            black[..., 3, 4] = brightest
            print(brightest, flip(torch.ones_like(black), black, 1.0, dynamic_range="HDR"), flush=True)
    """  # FLIP itself ends the process where the reference is black
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert run.stdout.splitlines() == ["0.0 nan", "1e-07 nan", "inf nan", "nan nan"], run.stdout + run.stderr


def test_flip_is_nan_where_a_pixel_is(images):
    image, reference = images[0].clone(), images[1]
    image[0, 1, 20, 10] = math.nan
    for dynamic_range in ("LDR", "HDR"):
        found = flip_map(image, reference, 1.0, dynamic_range)
        assert found.isnan().sum() == 1 and found[..., 20, 10].isnan()


def test_metrics_of_other_libraries_take_one_image(images):
    image, reference = images
    for metric in (ssim, flip):
        with pytest.raises(ValueError, match=r"expected one image \[1, 3, H, W\], got \(2, 3, 40, 30\)"):
            metric(image.repeat(2, 1, 1, 1), reference.repeat(2, 1, 1, 1), 1.0)
        assert metric(image.clone().requires_grad_(), reference, 1.0) == metric(image, reference, 1.0)


@pytest.mark.parametrize("metric", [psnr, mse, l1, ssim, relmse, smape, flip])
def test_shapes_that_torch_would_broadcast_are_refused(images, metric):
    image, reference = images
    mask = torch.ones(1, 1, 40, 30, dtype=torch.bool)
    for other in (reference[:, :1], reference[..., :1], reference[0], reference.repeat(2, 1, 1, 1)):
        with pytest.raises(ValueError, match=r"expected images of one shape \[1, 3, H, W\], got "):
            metric(image, other, 1.0)
    for other in (mask[..., :1], mask[0], mask.expand(1, 3, -1, -1)):
        with pytest.raises(ValueError, match=r"expected a mask \(1, 1, 40, 30\), got "):
            metric(image, reference, 1.0, other)


def test_flip_in_a_mask_and_what_it_does_not_take(images, monkeypatch):
    image, reference = images
    mask = torch.zeros(1, 1, 40, 30, dtype=torch.bool)
    mask[..., 7, 9] = True
    assert flip(image, reference, 1.0, mask) == pytest.approx(flip_map(image, reference, 1.0)[0, 0, 7, 9].item())
    with pytest.raises(ValueError, match="'SDR'"):
        flip(image, reference, 1.0, dynamic_range="SDR")
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    with pytest.raises(InputError, match="flip-evaluator"):
        flip(image, reference, 1.0)


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


def test_what_is_black_does_not_hide_what_is_not():
    """Up to half of the frame counts as it is; beyond that only as many black blocks as there are others."""
    light = torch.zeros(1, 3, 80, 80)
    for lit, expected in ((8, 0.7 / 0.9), (5, 0.4 / 0.9), (1, 8 / 18), (0.5, 4 / 9)):
        light[..., : int(8 * lit), :] = 2.0
        light[..., int(8 * lit) :, :] = 0.0
        if lit == 0.5:
            light[..., :8, :40], light[..., :8, 40:] = 2.0, 0.0
        assert 1 / exposure(light).item() == pytest.approx(2 * expected, rel=1e-5)
    light[..., :8, 8:] = 0.0  # one block is left
    assert 1 / exposure(light).item() == pytest.approx(1.0)


def test_display_exposure_brings_the_98th_percentile_to_09():
    values = torch.rand(1, 3, 50, 50) * 7
    assert torch.quantile(values * display_exposure(values), 0.98).item() == pytest.approx(0.9, abs=1e-3)


def test_fireflies_are_cut_and_lights_and_noise_are_not():
    noise = torch.empty(1, 3, 48, 64).exponential_()
    firefly = noise.clone()
    firefly[..., 20, 30] = torch.tensor([1e7, 2e7, 4e7])
    cut = limit_fireflies(firefly)
    assert cut[..., 20, 30].max() < 100 and cut[0, 1, 20, 30] == pytest.approx(2 * cut[0, 0, 20, 30].item())
    assert torch.equal(torch.where(firefly == noise, cut, 0), torch.where(firefly == noise, noise, 0))
    torch.testing.assert_close(limit_fireflies(firefly * 1e-6), cut * 1e-6)

    lamp = noise.clone()
    lamp[..., 20:22, 30:32] = 1e7  # as bright, but four pixels of it
    speck = torch.zeros(1, 3, 48, 64)
    speck[..., 20, 30] = 1e7  # nothing else in the frame to measure it by
    sparse = torch.where(torch.rand(1, 1, 48, 64) < 0.02, 1e4, noise)
    for kept in (noise, lamp, speck, sparse):
        assert torch.equal(limit_fireflies(kept), kept)
