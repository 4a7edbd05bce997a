"""Light that changes at once, as a lamp that flickers or a shadow that moves: what was seen before is outdated
(`ops.agrees`, `ops.outdated`)."""

from dataclasses import replace

import pytest
import torch
from synthetic import make_frames

from rtdenoise import glsl, models, ops
from rtdenoise.constants import OUTDATED_CELL
from rtdenoise.frame import Known
from rtdenoise.models import past
from rtdenoise.ops.agrees import agrees
from rtdenoise.ops.outdated import outdated

KINDS = ["default", "fast", "hybrid-fast", "many"]


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


def noisy(light, share=0.25, size=(64, 96)):
    """Light of which a share of the pixels sees all."""
    return light * (torch.rand(1, 1, *size) < share).expand(1, 3, -1, -1) / share


def everywhere(size=(64, 96)):
    return torch.ones(1, 1, *size, dtype=torch.bool)


def test_noise_is_no_change(choice):
    torch.manual_seed(0)
    mean = torch.stack([noisy(2.0) for _ in range(8)]).mean(0)
    assert agrees(noisy(2.0), mean, everywhere()).mean() > 0.95
    assert agrees(noisy(2.0), noisy(2.0), everywhere()).mean() > 0.95  # of one frame


@pytest.mark.parametrize("factor", [0.0, 0.4, 2.0])
def test_changed_light_is_told_from_noise(choice, factor):
    """In one half of the picture alone; cells beside it see some of both."""
    torch.manual_seed(0)
    light = noisy(1.0)
    light[..., 48:] *= factor
    found = agrees(light, torch.ones(1, 3, 64, 96), everywhere())
    assert found[..., :32].mean() > 0.95 and found[..., 64:].mean() < 0.1


def test_a_change_of_colour_is_one(choice):
    """Red gives way to as much blue."""
    torch.manual_seed(0)
    red, blue = (torch.tensor(c).view(1, 3, 1, 1) for c in ([1.0, 0.2, 0.2], [0.2, 0.2, 1.0]))
    assert agrees(blue * noisy(1.0), red.expand(1, 3, 64, 96), everywhere()).mean() < 0.1


def test_without_a_mean_nothing_disagrees(choice):
    assert (agrees(noisy(1.0), torch.full((1, 3, 64, 96), 50.0), ~everywhere()) == 1).all()


def test_sizes_must_fit():
    image = torch.zeros(1, 3, 8, 9)
    for mean, found in ((image[..., 1:], image[:, :1]), (image[:, :1], image[:, :1]), (image, image)):
        with pytest.raises(ValueError, match="expected two images"):
            agrees(image, mean, found > 0)


def test_a_cell_is_outdated_where_nothing_in_it_agrees():
    """The last cells are cut off by the border."""
    size = 2 * OUTDATED_CELL + 3, OUTDATED_CELL + 1
    agree, found = torch.zeros(1, 1, *size), torch.ones(1, 1, *size, dtype=torch.bool)
    agree[0, 0, 0, 2], agree[0, 0, -1, -1] = 0.25, 5.0
    found[..., OUTDATED_CELL : 2 * OUTDATED_CELL, :-1] = False  # surfaces that are all new
    share = outdated(found, agree)
    expected = torch.ones(1, 1, *size)
    expected[..., :OUTDATED_CELL, :OUTDATED_CELL] = 0.75
    expected[..., OUTDATED_CELL : 2 * OUTDATED_CELL, :OUTDATED_CELL] = 0.0
    expected[..., 2 * OUTDATED_CELL :, OUTDATED_CELL:] = 0.0
    assert torch.equal(share, expected)


def flickering(light, still=False):
    """A shot whose light is another in each frame; the noise is small."""
    size = {"H": 48, "W": 64, "noise": 0.4}
    frames = make_frames(len(light), **size)
    if still:
        frames = [make_frames(1, seed=i, **size)[0] for i in range(len(light))]
        frames = [replace(f, motion=0 * f.motion, motion_next=0 * f.motion) for f in frames]
    return [
        replace(frame, radiance=frame.radiance * of, reference=frame.reference * of)
        for frame, of in zip(frames, (torch.tensor(c).view(1, 3, 1, 1) for c in light), strict=True)
    ]


def error(image, frame):
    return ((image - frame.reference) / frame.reference.mean()).square().mean().sqrt().item()


@torch.inference_mode()
@pytest.mark.parametrize("still", [False, True], ids=["moves", "still"])
@pytest.mark.parametrize("name", KINDS)
def test_a_lamp_that_flickers_leaves_nothing_behind(name, still):
    """Whether it becomes brighter, darker or another colour: the picture is as good as one without history."""
    network, history = models.load(name, precision="fp32"), None
    shot = flickering([(1.0,) * 3, (1.0,) * 3, (4.0,) * 3, (0.5,) * 3, (2.0, 0.4, 0.4), (0.4, 0.4, 2.0)], still)
    for i, frame in enumerate(shot):
        image, history = network.step(frame, history, Known(still=still and i > 0))
        alone = network.step(frame)[0]
        if i >= 2:
            assert error(image, frame) < 1.15 * error(alone, frame), i


@torch.inference_mode()
def test_frames_ahead_agree_in_the_place_of_those_before():
    """Light that has just changed, and stays so: the mean is that of the frames after."""
    before, *ahead = flickering([(0.2,) * 3, (1.0,) * 3, (1.0,) * 3, (1.0,) * 3])
    config = models.PRESETS["default"]
    _, history = models.create(config).step(before)
    frame, ahead = ahead[0], tuple(ahead[1:])
    alone, both = (past.reprojected(config, frame, frame.radiance / 2, history, Known(ahead=a)) for a in ((), ahead))
    wall = (..., slice(24, 48), slice(None))  # the square is above
    assert (alone.outdated[wall] == 1).all() and not both.outdated[wall].any()
    assert not alone.on_screen[wall].any() and not both.on_screen[wall].any()  # the picture before is outdated anyway
    assert torch.equal(alone.output[wall], frame.radiance[wall])


@torch.inference_mode()
@pytest.mark.parametrize("name", KINDS)
def test_outdated_light_is_that_of_torch_in_the_shaders(name, gl, assert_images_close):
    network, pipeline = models.read(name), glsl.Pipeline.load(name)
    history = resident = None
    for i, frame in enumerate(flickering([(1.0,) * 3, (4.0,) * 3, (4.0, 0.5, 0.5), (1.0,) * 3])):
        known = Known(still=i == 3)
        if i == 3:
            frame = replace(frame, motion=0 * frame.motion, motion_next=0 * frame.motion)
        image, history = network.step(frame, history, known)
        found, resident = pipeline.step(frame.map(lambda t: t.numpy()), resident, known)
        assert_images_close(found, image, "frame")
