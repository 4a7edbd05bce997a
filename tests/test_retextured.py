"""Textures that move over their surfaces, as a conveyor belt's or a film's on a screen: motion vectors do not tell
(`ops.retextured`)."""

from dataclasses import replace

import pytest
import torch
from synthetic import make_frames, reset_of, thin

from rtdenoise import glsl, models, ops
from rtdenoise.constants import RETEXTURED_LEAST, RETEXTURED_MOST
from rtdenoise.frame import Frame, Known
from rtdenoise.models import past
from rtdenoise.ops.retextured import retextured

KINDS = ["default", "fast", "hybrid-fast", "many"]
SIZE = 46, 70


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


def boards(offset, size=SIZE, dark=0.1, light=0.8, side=9):
    """Boards of two shades, moved by so many pixels."""
    x = torch.div(torch.arange(size[1]) + offset, side, rounding_mode="floor") % 2
    return torch.where(x == 0, dark, light).expand(1, 3, *size).contiguous()


def everywhere(size=SIZE):
    return torch.ones(1, 1, *size, dtype=torch.bool)


def test_a_texture_that_moves_is_found(choice):
    assert (retextured(boards(4), boards(0), everywhere()) == 1).all()
    assert (retextured(boards(4), boards(4), everywhere()) == 0).all()
    assert retextured(boards(1), boards(0), everywhere()).mean() < 0.2, "less than the pixels around tell little"


def dots(offset, size=SIZE, apart=4, side=2):
    """Dots and what is between them so small that no 3×3 pixels show one of both alone."""
    x, y = (torch.arange(size[1]) + offset) % apart < side, torch.arange(size[0])[:, None] % apart < side
    return torch.where(x & y, 0.8, 0.1).expand(1, 3, *size).contiguous()


def test_a_texture_finer_than_the_pixels_around_is_found(choice):
    """The lamps of a running text: albedo of before lies nowhere beyond, but farther away than a neighbour's."""
    assert (retextured(dots(2), dots(0), everywhere()) == 1).all()
    assert (retextured(dots(2), dots(2), everywhere()) == 0).all()
    assert retextured(dots(1), dots(0), everywhere()).mean() < 0.1


def test_the_share_goes_by_how_far_albedo_lies_beyond(choice):
    flat = torch.full((1, 3, *SIZE), 0.4)
    for beyond, share in ((0.9 * RETEXTURED_LEAST, 0.0), ((RETEXTURED_LEAST + RETEXTURED_MOST) / 2, 0.5), (0.2, 1.0)):
        for sign in (-1, 1):
            found = retextured(flat, flat + sign * beyond / 3, everywhere())
            torch.testing.assert_close(found, torch.full_like(found, share), atol=1e-4, rtol=0)


@pytest.mark.parametrize("frames", [1, 8])
def test_noise_is_no_texture_that_moves(choice, frames):
    """Leaves and gravel: one sample a pixel finds another albedo in each frame."""
    torch.manual_seed(0)
    before = torch.stack([torch.rand(1, 1, *SIZE).mul(0.5).expand(1, 3, -1, -1) for _ in range(frames)]).mean(0)
    assert retextured(torch.rand(1, 1, *SIZE).mul(0.5).expand(1, 3, -1, -1), before, everywhere()).mean() < 0.1


def test_what_has_no_history_tells_nothing(choice):
    found = everywhere()
    found[..., 20:] = False
    share = retextured(boards(4), boards(0), found)
    assert (share[..., :20] == 1).all() and (share[..., 24:] == 0).all()
    assert (retextured(boards(4), boards(0), ~everywhere()) == 0).all()


def test_compiled_code_is_the_formula():
    torch.manual_seed(0)
    for size in ((1, 1), (2, 3), (4, 4), (21, 38)):
        a, b = torch.rand(2, 2, 3, *size)
        found = torch.rand(2, 1, *size) < 0.7
        with ops.use("plain"):
            plain = retextured(a, 0.2 + b, found)
        with ops.use("fused"):
            torch.testing.assert_close(retextured(a, 0.2 + b, found), plain, atol=1e-5, rtol=0)


def test_sizes_must_fit():
    image = torch.zeros(1, 3, 8, 9)
    for before, found in ((image[..., 1:], image[:, :1]), (image[:, :1], image[:, :1]), (image, image)):
        with pytest.raises(ValueError, match="expected two images"):
            retextured(image, before, found > 0)


def belt(number, speed, size=SIZE):
    """A wall whose boards move on, under light without noise in its mean. Its motion vectors are those of the wall."""
    g = torch.Generator().manual_seed(number)
    albedo = boards(speed * number, size)
    light = 2 * torch.rand(1, 1, *size, generator=g)
    motion = torch.full((1, 2, *size), 1e-3)  # not `Known.still`
    normal = torch.tensor([0, 0, 1.0]).view(1, 3, 1, 1).expand(1, 3, *size).contiguous()
    return Frame(albedo * light, albedo=albedo, normal=normal, depth=torch.full((1, 1, *size), 3.0), motion=motion,
                 motion_next=-motion, reference=albedo, number=number)  # fmt: skip


@torch.inference_mode()
@pytest.mark.parametrize("ahead", [0, 2])
@pytest.mark.parametrize("name", KINDS)
def test_boards_that_move_on_stay_sharp(name, ahead):
    """The picture is about as good as one without history."""
    network, history, frames = models.load(name, precision="fp32"), None, [belt(i, 5) for i in range(8)]
    for i, frame in enumerate(frames[:6]):
        known = Known(ahead=tuple(frames[i + 1 : i + 1 + ahead]))
        image, history = network.step(frame, history, known)
        alone = network.step(frame)[0]
    inside = (..., slice(8, -8), slice(8, -8))
    errors = [(x - frame.reference)[inside].square().mean().sqrt() for x in (image, alone)]
    assert errors[0] < 1.3 * errors[1]
    if network.config.recent:  # frames before the last one do not count, either
        assert reset_of(history.recent[0]).mean() > 0.9


def test_frames_ahead_give_way_alike():
    first, *ahead = (belt(i, 5) for i in range(3))
    found = past.reprojected(models.PRESETS["default"], first, first.radiance, None, Known(ahead=tuple(ahead)))
    one, two = found.later.recent
    assert found.turned.min() == 1 and reset_of(one).min() == 1 and not reset_of(two).any()


@torch.inference_mode()
@pytest.mark.parametrize("still", [False, True])
@pytest.mark.parametrize("name", KINDS)
def test_textures_that_move_are_those_of_torch_in_the_shaders(name, still, gl, weights, assert_images_close):
    path = weights(thin(name))
    network, pipeline = models.read(path), glsl.Pipeline.load(path)
    history = resident = None
    for i, frame in enumerate(make_frames(3, H=21, W=38)):
        frame = replace(frame, albedo=(0.5 * frame.albedo + 0.5 * boards(5 * i, (21, 38))).contiguous())
        if still:
            frame = replace(frame, motion=0 * frame.motion, motion_next=0 * frame.motion)
        known = Known(still=still and i > 0)
        image, history = network.step(frame, history, known)
        found, resident = pipeline.step(frame.map(lambda t: t.numpy()), resident, known)
        assert_images_close(found, image, "frame")
    if network.config.recent:
        assert reset_of(history.recent[0]).mean() > 0.1
