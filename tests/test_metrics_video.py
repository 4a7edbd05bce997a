"""Metrics of sequences against closed forms and scikit-image."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio
from synthetic import make_frames

from rtdenoise.color import display, srgb_decode
from rtdenoise.errors import InputError
from rtdenoise.evaluate import uncovered
from rtdenoise.metrics import (
    fovvideovdp,
    ghost_length,
    recent_masks,
    temporal_relmae,
    tmse_corrected,
    tpsnr,
    tpsnr_corrected,
)
from rtdenoise.metrics.video import ages


def test_tpsnr_is_the_psnr_of_differences():
    images, references = torch.rand(2, 2, 3, 12, 10).split(1)
    images, references = ([x[0, i : i + 1] for i in range(2)] for x in (images, references))
    difference, difference_r = ((display(x[1]) - display(x[0])).numpy() for x in (images, references))
    expected = peak_signal_noise_ratio(difference_r, difference, data_range=1.0)
    assert tpsnr(images, references, 1.0) == pytest.approx(expected, abs=1e-4)


def test_a_steady_error_does_not_flicker():
    reference, image = torch.rand(2, 1, 3, 8, 8).split(1)
    assert tpsnr((image[0], image[0]), (reference[0], reference[0]), 1.0) == math.inf
    assert temporal_relmae((image[0], image[0]), (reference[0], reference[0]), 1.0) == 0
    assert math.isnan(tpsnr((image[0],) * 2, (reference[0],) * 2, 1.0, torch.zeros(1, 1, 8, 8, dtype=torch.bool)))


def test_corrected_tpsnr_does_not_see_the_noise_of_references():
    g = torch.Generator().manual_seed(6)
    truth = [0.1 + 0.3 * torch.rand(1, 3, 96, 96, generator=g) for _ in "12"]
    images = tuple(x + 0.01 * torch.randn(x.shape, generator=g) for x in truth)
    halves = tuple(x + 0.02 * torch.randn(x.shape, generator=g) for x in truth)
    others = tuple(x + 0.02 * torch.randn(x.shape, generator=g) for x in truth)
    references = tuple((a + b) / 2 for a, b in zip(halves, others, strict=True))
    mask = torch.rand(1, 1, 96, 96, generator=g) < 0.5
    for where in (None, mask):
        true = tpsnr(images, tuple(truth), 1.0, where)
        assert tpsnr_corrected(images, references, 1.0, where, reference_halves=halves) == pytest.approx(true, abs=0.1)
        assert tpsnr(images, references, 1.0, where) < true - 4  # what it hides
    # Noise that is the same in both frames does not flicker, and is not taken out.
    still = tpsnr_corrected(images, (references[0],) * 2, 1.0, reference_halves=(halves[0],) * 2)
    assert still == tpsnr(images, (references[0],) * 2, 1.0)
    own = tmse_corrected(references, references, 1.0, reference_halves=halves)
    assert own < 0 and math.isnan(tpsnr_corrected(references, references, 1.0, reference_halves=halves))


def test_temporal_relmae_of_flat_images():
    one = torch.ones(1, 3, 4, 4)
    # In exposed units: ΔI = 6 - 2, ΔR = 2 - 1.
    assert temporal_relmae((one, one * 3), (one * 0.5, one), 2.0) == pytest.approx(3 / 2.01)


@pytest.mark.parametrize("metric", [tpsnr, temporal_relmae])
def test_pairs_that_torch_would_broadcast_are_refused(metric):
    image = torch.rand(1, 3, 8, 9)
    for other in (image[:, :1], image[..., :1], image[0]):
        with pytest.raises(ValueError, match=r"expected images of one shape \[1, 3, H, W\], got "):
            metric((image, image), (image, other), 1.0)


def test_recent_masks_fill_in_with_the_newest():
    masks = [torch.full((1, 1, 2, 2), float(i)) for i in range(4)]
    assert [[m[0, 0, 0, 0].item() for m in recent_masks(masks, i)] for i in (0, 1, 3)] == [
        [0, 0, 0], [1, 0, 1], [3, 2, 1],
    ]  # fmt: skip


def test_ages_follow_the_surface():
    H, W = 4, 12
    masks = [torch.zeros(1, 1, H, W, dtype=torch.bool) for _ in range(4)]
    masks[1][..., 3] = True
    right = torch.tensor([-2.0, 0.0]).reshape(1, 2, 1, 1).expand(1, 2, H, W)  # everything moves right by 2 px a frame
    last = [*ages([right] * 4, masks)][3]
    assert (last[..., 7] == 2).all() and last.isfinite().sum() == H


def test_ages_of_a_moving_square_grow_behind_it():
    frames = make_frames(6)
    last = [*ages([f.motion for f in frames], uncovered(frames))][5]
    row = last[0, 0, 10]
    assert row[6:16].tolist() == [4, 4, 3, 3, 2, 2, 1, 1, 0, 0]  # uncovered two columns a frame
    assert row[:6].isinf().all() and row[16:].isinf().all()


def ghost(errors_by_age, count=10, settled=4):
    """Ghost length of a sequence at rest in which column 0 is uncovered in frame 1 with the given squared errors."""
    masks = [torch.zeros(1, 1, 3, 3, dtype=torch.bool) for _ in range(count)]
    masks[1][..., 0] = True
    errors = [0.5] + [errors_by_age[min(k, len(errors_by_age) - 1)] for k in range(count - 1)]
    images = [torch.full((1, 3, 3, 3), srgb_decode(torch.tensor(e).sqrt()).item()) for e in errors]
    still, black = torch.zeros(1, 2, 3, 3), torch.zeros(1, 3, 3, 3)
    return ghost_length(images, [black] * count, [still] * count, masks, 1.0, settled)


def test_ghost_length_counts_frames_until_the_error_has_settled():
    assert ghost([0.1]) == 0
    assert ghost([0.4, 0.2, 0.105, 0.1]) == 2  # within 10 % from age 2 on
    assert ghost([0.1, 0.4, 0.1]) == 2  # a late ghost counts
    assert ghost([0.9, 0.8, 0.7, 0.6, 0.1]) == 4  # not before the ages that are taken for settled
    assert math.isnan(ghost([0.1], count=4))  # too short to know
    assert math.isnan(ghost_length([], [], [], [], 1.0))


class StandIn:
    """Stands in for pyfvvdp and records its arguments: the licence of the real one keeps it out of the tests."""

    def fvvdp(self, **options):
        self.options = options
        return self

    def predict(self, test, reference, **how):
        self.given = test, reference, how
        return torch.tensor(7.5), SimpleNamespace()


def test_fovvideovdp_gets_encoded_frames_test_first(monkeypatch):
    stand_in = StandIn()
    monkeypatch.setitem(sys.modules, "pyfvvdp", stand_in)
    images, references = ([torch.rand(1, 3, 6, 9) for _ in range(4)] for _ in range(2))
    assert fovvideovdp(images, references, 0.5, frames_per_second=24) == 7.5
    test, reference, how = stand_in.given
    assert how == {"dim_order": "FHWC", "frames_per_second": 24}
    assert test.shape == reference.shape == (4, 6, 9, 3)
    np.testing.assert_array_equal(test[2], display(images[2], 0.5)[0].permute(1, 2, 0))
    np.testing.assert_array_equal(reference[2], display(references[2], 0.5)[0].permute(1, 2, 0))
    assert stand_in.options["display_name"] == "standard_4k"


def test_fovvideovdp_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyfvvdp", None)
    with pytest.raises(InputError, match="pip install pyfvvdp"):
        fovvideovdp([torch.rand(1, 3, 6, 9)], [torch.rand(1, 3, 6, 9)], 1.0)
