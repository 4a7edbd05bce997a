"""The filter of single pictures by the networks of `hybrid-large` (`run.pixel_filter`)."""

from dataclasses import replace

import pytest
import torch

from rtdenoise.baselines import Oidn
from rtdenoise.color import compress
from rtdenoise.data.opening import open_sequence
from rtdenoise.evaluate.demo import SAMPLE
from rtdenoise.frame import Frame
from rtdenoise.run import pixel_filter
from rtdenoise.run.pixel_filter import PixelFilter, in_tiles
from rtdenoise.sanitise import sanitise


@pytest.fixture(scope="module")
def own():
    return PixelFilter()


@pytest.fixture(scope="module")
def frame():
    return sanitise(open_sequence(SAMPLE)[0])


def test_it_is_nearly_oidn(own, frame):
    """Albedo and normal as its balanced quality filters them, light as its high one does; weights are rounded."""
    theirs, ours = Oidn("balanced").prefiltered(frame), own.prefiltered(frame)
    for name in ("albedo", "normal"):
        noisy, filtered = (getattr(x, name) for x in (frame, ours))
        off = (filtered - getattr(theirs, name)).abs().mean()
        assert off < 0.01 and off < 0.5 * (noisy - filtered).abs().mean(), name
    light, expected = own.step(theirs)[0], Oidn(clean=True).step(theirs)[0]
    brightness = expected.mean()
    assert ((light - expected).abs() / (expected + brightness)).mean() < 0.015


def test_it_scales_with_the_light(own, frame):
    image = own.step(frame)[0]
    scaled = own.step(replace(frame, radiance=1e4 * frame.radiance))[0]
    torch.testing.assert_close(compress(scaled / 1e4), compress(image), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("light", [0.0, 1e-6, 3e4])
def test_even_light_stays_even(own, light):
    layer = torch.full((1, 3, 20, 33), 0.5)
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).expand_as(layer)
    assert torch.equal(own.step(Frame(light * layer, layer, normal, layer[:, :1]))[0], light * layer)


@pytest.mark.parametrize(("precision", "bound"), [("fp32", 0), ("bf16", 0.2), ("int8", 0.5)])
def test_precision(own, frame, precision, bound):
    """Float32 by itself; others are within a share of the noise that is removed."""
    found, expected = PixelFilter(precision=precision).prefiltered(frame), own.prefiltered(frame)
    for name in ("albedo", "normal"):
        filtered = getattr(expected, name)
        off = (getattr(found, name) - filtered).abs().mean()
        assert (off > 0) == (bound > 0) and off <= bound * (getattr(frame, name) - filtered).abs().mean(), name


def test_tiles_are_the_whole(own, monkeypatch, frame):
    wide = frame.map(lambda layer: layer.repeat(1, 1, 3, 4)[..., :260, :270])  # three rows and columns of tiles
    whole = own.prefiltered(wide), own.step(wide)[0]
    monkeypatch.setattr(pixel_filter, "TILE", 128)
    tiled = own.prefiltered(wide), own.step(wide)[0]
    for name in ("albedo", "normal"):
        torch.testing.assert_close(getattr(tiled[0], name), getattr(whole[0], name), rtol=0, atol=1e-4)
    torch.testing.assert_close(compress(tiled[1]), compress(whole[1]), rtol=1e-4, atol=1e-4)
    seen = []
    in_tiles(lambda x: (seen.append(x.shape) or x,), 40, torch.rand(1, 3, 300, 300))
    assert len(seen) == 9 and max(max(shape[2:]) for shape in seen) <= 128 + 2 * 64


@pytest.mark.parametrize("precision", ["fp32", "int8"])
def test_a_lamp_keeps_its_light(precision):
    """Bytes end at some five thousand times a frame's brightness."""
    light, normal = torch.full((1, 3, 96, 96), 1e-5), torch.zeros(1, 3, 96, 96)
    light[..., 40:56, 40:56] = 1.0
    torch.manual_seed(0)
    noisy = light * torch.empty(1, 1, 96, 96).exponential_()
    image = PixelFilter(precision=precision).step(Frame(noisy, torch.full_like(light, 0.5), normal, light[:, :1]))[0]
    middle = image[..., 42:54, 42:54], noisy[..., 42:54, 42:54]
    assert middle[0].mean().item() == pytest.approx(middle[1].mean().item(), rel=0.2)
    assert image[..., :20, :].mean().item() == pytest.approx(1e-5, rel=0.2)
