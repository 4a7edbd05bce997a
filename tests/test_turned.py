"""Surfaces that turn: what they reflect moves otherwise, so their history gives way (`ops.turned`)."""

import math
from dataclasses import replace

import pytest
import torch
from synthetic import make_frames, reset_of, thin

from rtdenoise import glsl, models, ops
from rtdenoise.constants import TURNED_ANGLE, TURNED_NOISE
from rtdenoise.frame import Frame, Known
from rtdenoise.models import hybrid, past
from rtdenoise.ops.turned import turned

SIZE = 22, 30
KINDS = ["default", "fast", "hybrid-fast", "many"]


@pytest.fixture(params=["plain", "fused"])
def choice(request):
    with ops.use(request.param):
        yield


def facing(degrees, size=SIZE):
    """The normals of a bent surface, turned about the y axis."""
    x = torch.linspace(-0.5, 0.5, size[1]) + math.radians(degrees)
    return torch.stack([x.sin(), torch.zeros_like(x), x.cos()]).view(1, 3, 1, -1).expand(1, 3, *size).contiguous()


@pytest.mark.parametrize("degrees", [0.0, 0.5, 3.0, -12.0])
def test_a_turn_is_measured(choice, degrees):
    share = turned(2 * facing(degrees), facing(0.0))
    chord = 2 * math.sin(math.radians(abs(degrees)) / 2)
    expected = -math.expm1(-chord * (1 - TURNED_NOISE / 144) / TURNED_ANGLE)  # of 3 × 3 cells
    torch.testing.assert_close(share[..., 4:16, 4:24], torch.full((1, 1, 12, 20), expected), atol=0, rtol=0.01)
    assert share.shape == (1, 1, *SIZE) and (share <= share[0, 0, 8, 8] + 1e-6).all()  # fewer cells, less sure
    assert (share >= 0.75 * expected).all()


def test_noise_is_no_turn(choice):
    """Leaves and grain: one sample a pixel finds another normal in each frame."""
    torch.manual_seed(0)
    a, b = (torch.randn(1, 3, 64, 64) + torch.tensor([0, 0, 2.0]).view(3, 1, 1) for _ in range(2))
    assert turned(a, b).mean() < 2e-3


def test_nothing_to_compare(choice):
    nothing, full = torch.zeros(1, 3, *SIZE), facing(0.0)
    for pair in ((nothing, full), (full, nothing), (nothing, nothing)):
        assert not turned(*pair).any()
    half = facing(9.0)
    half[..., 15:] = 0  # the sky
    share = turned(half, full)
    assert (share[..., :15] > 0.6).all() and not share[..., 24:].any()


def test_what_turns_about_its_normal_stays(choice):
    """Light in a mirror is the same then."""
    assert not turned(facing(0.0)[..., 15:16].expand(1, 3, *SIZE), facing(0.0)[..., 15:16].expand(1, 3, *SIZE)).any()


def test_sizes_must_fit():
    for before in (torch.zeros(1, 3, 8, 9), torch.zeros(1, 1, 8, 8), torch.zeros(3, 8, 8)):
        with pytest.raises(ValueError, match="expected two images"):
            turned(torch.zeros(1, 3, 8, 8), before)


def turning(degrees, light, size=(32, 48)):
    """A frame of one surface, lit in one of eight pixels, of each 2 × 4, so that the mean has no noise."""
    full = torch.ones(1, 1, *size)
    motion = torch.full((1, 2, *size), 1e-3)  # not `Known.still`
    lit = torch.eye(8)[torch.randint(8, (size[0] // 2, size[1] // 4))].unflatten(2, (2, 4))
    image = 8 * light * lit.permute(0, 2, 1, 3).reshape(1, 1, *size).expand(1, 3, -1, -1)
    return Frame(image, albedo=0.5 * torch.ones_like(image), normal=facing(degrees, size), depth=full,
                 motion=motion, motion_next=motion)  # fmt: skip


@torch.inference_mode()
@pytest.mark.parametrize("name", KINDS)
def test_history_gives_way_where_surfaces_turn(name, monkeypatch):
    """The light of a wall dims by a tenth, too little for its noise. On one that turns, the picture follows, also if
    history is not made as bright as the frame (`ops.relit`)."""
    monkeypatch.setattr(past, "_relit", lambda found, *_: found)
    network = models.load(name)
    torch.manual_seed(0)

    def after(degrees, light):
        history = None
        for i in range(6):
            _, history = network.step(turning(i * degrees, light), history)
        return network.step(turning(6 * degrees, 0.9), history)[0].mean().item(), history

    still, turns = (abs(after(degrees, 1.0)[0] - after(degrees, 0.9)[0]) for degrees in (0.0, 8.0))
    assert turns < 0.5 * still
    _, history = after(8.0, 1.0)
    share = -math.expm1(-math.radians(8.0) / TURNED_ANGLE)
    if network.config.recent:  # frames that are kept count less, too
        assert reset_of(history.recent[0]).min() > 0.9 * share


@torch.inference_mode()
def test_kernels_count_half_where_surfaces_turn(monkeypatch):
    """Their picture does not lag behind there: its light has given way already."""
    network, trusts = models.read("hybrid-fast"), []
    network.full_head.weight[:, -2], network.full_head.bias[-2] = 0, -100.0  # a network that never resets
    monkeypatch.setattr(hybrid, "mix", lambda first, other, scale, trust, *rest: trusts.append(trust) or other)
    history = None
    for i in range(3):
        _, history, kernels = network.step_and_kernels(turning(8.0 * i, 1.0), history)
    assert not kernels.reset.any() and kernels.heads.reset.min() > 0.7
    torch.testing.assert_close(trusts[-1], 1 - kernels.heads.reset / 2)
    assert (trusts[0] == 1).all()  # a first frame has no history that could lag


def test_frames_ahead_give_way_alike():
    """Those of a first frame, too, which has no others."""
    first, *ahead = (turning(8.0 * i, 1.0) for i in range(3))
    found = past.reprojected(models.PRESETS["default"], first, first.radiance, None, Known(ahead=tuple(ahead)))
    one, two = found.later.recent
    share = -math.expm1(-math.radians(8.0) / TURNED_ANGLE)
    assert min(found.turned.min(), reset_of(one).min()) > 0.9 * share and not reset_of(two).any()


@torch.inference_mode()
@pytest.mark.parametrize("name", KINDS)
def test_frames_that_turn_are_those_of_torch_in_the_shaders(name, gl, weights, assert_images_close):
    path = weights(thin(name))
    network, pipeline = models.read(path), glsl.Pipeline.load(path)
    history = resident = None
    for i, frame in enumerate(make_frames(3, H=21, W=38)):
        frame = replace(frame, normal=facing(7.0 * i, (21, 38)))
        image, history = network.step(frame, history)
        found, resident = pipeline.step(frame.map(lambda t: t.numpy()), resident)
        assert_images_close(found, image, "frame")
    if network.config.recent:
        assert reset_of(history.recent[0]).mean() > 0.4
        words = torch.from_numpy(resident.recent[0].read()[None].view("int32"))
        assert_images_close(reset_of(words), reset_of(history.recent[0]), "bfloat16 rounding")
