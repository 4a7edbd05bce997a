"""The three terms of the loss, each on numbers that can be checked by hand."""

import math

import pytest
import torch

from rtdenoise.models.losses import temporal_kpn_loss


def flat(value):
    return torch.full((1, 3, 2, 2), math.expm1(value))  # compresses to `value`


def test_spatial_term_is_l1_of_the_compressed_radiance():
    loss = temporal_kpn_loss(flat(0.5), flat(0.2), None, None)
    assert loss.spatial.item() == pytest.approx(0.3)
    assert loss.temporal == 0 and loss.occlusion == 0
    assert loss.total.item() == pytest.approx(0.3)


def test_temporal_term_compares_differences_between_frames():
    loss = temporal_kpn_loss(flat(0.5), flat(0.2), (flat(0.4), flat(0.3)), None)
    assert loss.temporal.item() == pytest.approx(0.2)  # (0.5 - 0.4) - (0.2 - 0.3)
    same_flicker = temporal_kpn_loss(flat(0.5), flat(0.2), (flat(0.6), flat(0.3)), None)
    assert same_flicker.temporal.item() == pytest.approx(0.0, abs=1e-6)


def test_occlusion_term_counts_weighted_pixels_only():
    weights = torch.zeros(1, 1, 2, 2)
    weights[..., 0, 1] = 1.8
    loss = temporal_kpn_loss(flat(0.5), flat(0.2), None, weights)
    assert loss.occlusion.item() == pytest.approx(0.3 * 1.8 / 4)


def test_exposure_is_applied_before_the_compression():
    image, reference = torch.full((1, 3, 2, 2), 2.0), torch.full((1, 3, 2, 2), 1.0)
    loss = temporal_kpn_loss(image, reference, None, None, scale=torch.full((1, 1, 1, 1), 3.0))
    assert loss.spatial.item() == pytest.approx(math.log(7 / 4))


def test_each_image_of_a_batch_has_its_own_loss():
    image, reference = torch.cat([flat(0.5), flat(0.3)]), torch.cat([flat(0.2), flat(0.2)])
    loss = temporal_kpn_loss(image, reference, (image, reference), None)
    torch.testing.assert_close(loss.total, torch.tensor([0.3, 0.1]))


def test_a_firefly_does_not_rule_the_loss():
    image = flat(0.2)
    image[0, 0, 0, 0] = 1e6
    assert temporal_kpn_loss(image, flat(0.2), None, None).spatial < 1.5
