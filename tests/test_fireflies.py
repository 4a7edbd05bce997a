"""Lone bright pixels that nothing but noise makes bright (`ops.fireflies`)."""

from dataclasses import replace

import pytest
import torch

from rtdenoise import models, ops
from rtdenoise.frame import Frame
from rtdenoise.models import PRESETS
from rtdenoise.ops.fireflies import without_fireflies

SIZE = 9, 12


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


def wall(known=0.0, size=SIZE):
    """Light, depth, normal and `known` of an even wall."""
    normal = torch.zeros(1, 3, *size)
    normal[:, 2] = 1
    return torch.ones(1, 3, *size), torch.full((1, 1, *size), 5.0), normal, torch.full((1, 1, *size), known)


@pytest.mark.parametrize("pixels", [1, 2])
def test_a_firefly_is_as_bright_as_the_second_brightest_beside_it(choice, pixels):
    light, *others = wall()
    light[..., 4, 5 : 5 + pixels] = torch.tensor([500.0, 3.0, 1.0])[:, None]
    light[:, 2, 3, 4] = light[:, 2, 5, 6] = 2.0
    even = torch.ones_like(light)
    even[:, 2, 3, 4] = even[:, 2, 5, 6] = 1.0
    assert torch.equal(without_fireflies(light, *others), even)


def test_what_frames_before_have_shown_stays(choice):
    light, *others = wall(known=1.0)
    light[..., 4, 5] = 500.0
    assert torch.equal(without_fireflies(light, *others), light)
    half = without_fireflies(light, *wall(known=0.5)[1:])
    assert half[..., 4, 5].tolist() == [[250.5] * 3]


@pytest.mark.parametrize("detail", ["line", "corner", "block"])
def test_details_of_several_pixels_stay(choice, detail):
    light, *others = wall()
    if detail == "line":
        light[..., 4, :] = 7.0
    elif detail == "corner":
        light[..., :5, :6] = 7.0
    else:
        light[..., 4:6, 5:7] = 7.0
    assert torch.equal(without_fireflies(light, *others), light)


@pytest.mark.parametrize("of", ["depth", "normal", "sky"])
def test_details_of_surfaces_stay(choice, of):
    """A flake before a wall, a bead on it, and a star."""
    light, depth, normal, known = wall()
    light[..., 4, 5] = 500.0
    if of == "depth":
        depth[..., 4, 5] = 3.0
    elif of == "normal":
        normal[..., 4, 5] = torch.tensor([1.0, 0.0, 0.0])
    else:
        depth[:] = 0.0
    assert torch.equal(without_fireflies(light, depth, normal, known), light)


def test_the_border_and_pictures_that_are_only_border_stay(choice):
    light, *others = wall()
    light[..., 0, 5] = light[..., 4, 0] = light[..., -1, -1] = 500.0
    assert torch.equal(without_fireflies(light, *others), light)
    for size in ((1, 1), (2, 9), (9, 2)):
        light, *others = wall(size=size)
        light[..., 0, 0] = 500.0
        assert torch.equal(without_fireflies(light, *others), light)


@pytest.mark.parametrize("many", [False, True])
def test_networks_for_few_samples_leave_what_history_knows(many, monkeypatch):
    """Lone bright pixels that their networks write, on an even wall."""
    network = models.create(replace(PRESETS["hybrid-fast"], many=many)).eval()
    monkeypatch.setattr("rtdenoise.models.hybrid.mix", lambda first, *others: spotted(first))
    light, depth, normal, _ = wall(size=(32, 32))
    still = {"motion": torch.zeros(1, 2, 32, 32), "motion_next": torch.zeros(1, 2, 32, 32)}
    frame = Frame(light, albedo=light / 2, normal=normal, depth=depth, **still)
    with torch.inference_mode():
        first, history = network.step(frame)
        second, _, kernels = network.step_and_kernels(frame, history)
    trust = 1 - kernels.heads.reset[..., 7, 9].item()
    assert 0.9 < trust < 1
    for image, known in ((first, 1.0 if many else 0.0), (second, 1.0 if many else trust)):
        dark, spot = image[..., 8, 9].mean().item(), image[..., 7, 9].mean().item()
        assert spot == pytest.approx(dark + known * (500 - dark), rel=0.05)


def spotted(image: torch.Tensor) -> torch.Tensor:
    image = image.clone()
    image[..., 7, 9] = 500.0
    return image


def test_sizes_must_fit(choice):
    light, depth, normal, known = wall()
    for given in (
        (light[:, :1], depth, normal, known),
        (light, depth[..., 1:], normal, known),
        (light, depth, normal[:, :2], known),
        (light, depth, normal, normal),
    ):
        with pytest.raises(ValueError, match="to fit"):
            without_fireflies(*given)


def test_light_has_a_gradient():
    light, *others = wall(known=0.25)
    light[..., 4, 5] = 500.0
    light.requires_grad_()
    without_fireflies(light, *others).sum().backward()
    assert light.grad[0, 0, 4, 5] == 0.25 and light.grad[0, 0, 2, 2] > 0.1
