"""Light of earlier frames, as bright as it is now (`ops.relit`)."""

from dataclasses import replace

import pytest
import torch

import rtdenoise
from rtdenoise import ops
from rtdenoise.constants import RELIT_CELL, RELIT_MOST
from rtdenoise.frame import Frame
from rtdenoise.models import past
from rtdenoise.ops.relit import gain, relit_

H, W = 192, 256
HALF = W // RELIT_CELL // 2
WINDOW = 3 * 16 // RELIT_CELL  # side of the greatest window in cells


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


def noisy(light=1.0, size=(H, W)):
    """Light of one sample a pixel: one in four hits the lamp."""
    return light * 4.0 * (torch.rand(1, 1, *size) < 0.25) * torch.rand(1, 1, *size).expand(1, 3, *size) * 2.0


def mean(frames=8):
    return sum(noisy() for _ in range(frames)) / frames


def everywhere(size=(H, W)):
    return torch.ones(1, 1, *size, dtype=torch.bool)


def test_noise_alone_changes_hardly_anything(choice):
    """Cells keep their light to the bit, but for few."""
    found = gain(mean(), noisy(), everywhere())
    assert (found == 1).float().mean() > 0.75
    assert (found - 1).abs().mean() < 0.02


def test_a_lamp_that_changes_by_less_than_the_noise_is_followed(choice):
    """By a third on the left, where each pixel's noise is eight times as much; on the right it stays."""
    lamp = torch.where(torch.arange(W) < W // 2, 4 / 3, 1.0)
    found = gain(mean(), noisy(lamp), everywhere())
    left, right = found[..., : HALF - WINDOW], found[..., HALF + WINDOW :]
    assert abs(left.mean() - 4 / 3) < 0.06 and abs(right.mean() - 1) < 0.02
    darker = gain(mean(), noisy(0.6), everywhere())
    assert abs(darker.mean() - 0.6) < 0.03


def test_a_coloured_lamp_changes_its_colours(choice):
    red = torch.tensor([1.5, 1.0, 1.0]).view(1, 3, 1, 1)
    found = gain(mean(), noisy(red), everywhere()).mean((0, 2, 3))
    assert abs(found[0] - 1.5) < 0.06 and (found[1:] - 1).abs().max() < 0.03


def test_texture_beside_its_place_is_no_light(choice):
    """Tiles of eight pixels, of two greys, looked up three pixels off: as often brighter as darker."""
    y, x = torch.meshgrid(torch.arange(H), torch.arange(W), indexing="ij")
    tiles = 0.5 + 0.5 * torch.rand(1, 1, H // 8 + 1, W // 8 + 1)[..., y // 8, x // 8].expand(1, 3, H, W)
    found = gain(tiles.roll((3, 3), (2, 3)), tiles, everywhere())
    assert (found == 1).float().mean() > 0.6 and (found - 1).abs().mean() < 0.02


def test_only_what_is_found_is_compared(choice):
    """On the left nothing is; all that is found has stayed."""
    before, now = torch.ones(1, 3, H, W), torch.ones(1, 3, H, W)
    now[..., : W // 2] = 3.0
    found = everywhere()
    found[..., : W // 2] = False
    assert (gain(before, now, found) == 1).all()
    assert (gain(before, now, ~everywhere()) == 1).all()
    assert gain(before, now, everywhere())[..., 0].min() > 2.9


@pytest.mark.parametrize("light", [0.0, 1e-30, 1e15])
def test_extreme_light_is_followed_within_bounds(choice, light):
    dark, bright = torch.zeros(1, 3, H, W), torch.full((1, 3, H, W), light)
    for before, now in ((dark, bright), (bright, dark), (bright, bright)):
        found = gain(before, now, everywhere())
        assert found.isfinite().all() and (found > 0).all()
        assert found.max() <= RELIT_MOST**2 * 1.001 and found.min() >= RELIT_MOST**-2 * 0.999
    assert (gain(bright, bright, everywhere()) == 1).all()


def test_an_image_is_multiplied_in_place(choice):
    """Its first three channels, to the bit but where the gain is another; with gradients in a copy."""
    times = torch.ones(1, 3, 5, 8)
    times[:, 1, 2:] = 2.0
    image = torch.rand(1, 5, 18, 30)
    expected = image.clone()
    expected[:, 1, 8:] *= 2.0
    assert relit_(image, times) is image and torch.equal(image, expected)
    picture = torch.rand(1, 3, 18, 30, requires_grad=True)
    relit_(picture, times).sum().backward()
    assert torch.equal(picture.grad, times.repeat_interleave(4, 2).repeat_interleave(4, 3)[..., :18, :30])
    with pytest.raises(ValueError, match="its gain"):
        relit_(image, times[..., 1:])


@pytest.mark.parametrize("name", ["fast", "default", "hybrid"])
def test_a_lamp_that_flickers_costs_less(name, monkeypatch):
    """A wall, half of which is lit more and less from frame to frame."""
    size, errors = (96, 160), {}
    lamps = [torch.where(torch.arange(160) < 80, times, 1.0) for times in (1.0, 1.4, 1.0, 1.2, 0.9, 1.3)]
    one = torch.ones(1, 1, *size)
    wall = Frame(one.expand(1, 3, *size), albedo=0.5 * one.expand(1, 3, *size), depth=4 * one,
                 normal=torch.cat([0 * one, 0 * one, one], dim=1), motion=0 * one.expand(1, 2, *size))  # fmt: skip
    frames = [replace(wall, radiance=noisy(lamp, size), number=i) for i, lamp in enumerate(lamps)]
    network, follows = rtdenoise.load(name), past._relit
    for kind, relit in (("follows", follows), ("stays", lambda found, frame, noisy: found)):
        monkeypatch.setattr(past, "_relit", relit)
        history, errors[kind] = None, 0.0
        with torch.no_grad():
            for frame, lamp in zip(frames, lamps, strict=True):
                image, history = network.step(frame, history)
                errors[kind] += (image - lamp)[..., :64].square().mean().item()
    assert errors["follows"] < 0.9 * errors["stays"]
