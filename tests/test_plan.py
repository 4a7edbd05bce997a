"""Omissions of the plan change nothing: to the bit, or within the tolerance of float32."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import TINY, make_frames, save_tiny, write_sequence

from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.frame import OFF_SCREEN, Known
from rtdenoise.models import AccumulatedKPNConfig, TemporalKPN, available, create, load
from rtdenoise.motion import dual_motion, occlusion_mask
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.normals import are_encoded
from rtdenoise.run.parts import check_sign
from rtdenoise.run.plan import look, make_plan, varied_rows
from rtdenoise.run.planned import Planned
from rtdenoise.run.tiles import Tiled
from rtdenoise.splat import splat_motion_next


@pytest.fixture(scope="module")
def denoiser():
    torch.manual_seed(0)
    return TemporalKPN(TINY).eval().requires_grad_(False)


SMALL = [TINY, AccumulatedKPNConfig(widths=(4, 4, 4, 4), scales=4, edge_kernel=3, pick_kernel=3, detail=True)]


@pytest.fixture(scope="module", params=SMALL, ids=lambda config: config.architecture)
def either(request):
    """Of each architecture, one that runs in no time."""
    torch.manual_seed(0)
    return create(request.param).eval().requires_grad_(False)


def planned(denoiser, frames):
    return Planned(denoiser, make_plan(frames[0].size, len(frames), denoiser.config.motion, frames[:3]))


def play(denoiser, frames):
    """Omissions in a first frame round; they are made with and without the plan, and have a test of their own."""
    history, images = None, []
    for frame in frames:
        image, history = denoiser.step(frame, history, Known(first=history is None))
        images.append(image)
    return images, history


def assert_same(one, other, check=torch.equal):
    (images, history), (others, other_history) = one, other
    assert all(check(a, b) for a, b in zip(images, others, strict=True))
    assert history.layers().keys() == other_history.layers().keys()
    assert all(check(t, other_history.layers()[name]) for name, t in history.layers().items())


def close(a, b):
    return torch.allclose(a, b, rtol=1e-5, atol=1e-5)


def moved(frames, speed):
    """Everything moves alike, as under a panning camera."""
    motion = torch.tensor(speed).reshape(1, 2, 1, 1).expand_as(frames[0].motion).contiguous()
    return [replace(f, motion=-motion, motion_next=motion) for f in frames]


def test_nothing_is_warped_where_nothing_moves(either):
    frames = moved(make_frames(4), [0.0, 0.0])
    plan = planned(either, frames)
    assert_same(play(plan, frames), play(either, frames))
    assert plan.left_out["warp of history"] == plan.left_out["dual motion"] == 3


def test_one_moving_pixel_is_enough_for_a_warp(either):
    frames = moved(make_frames(4), [0.0, 0.0])
    for layer, number in (("motion", 2), ("motion_next", 0)):
        changed = list(frames)
        field = getattr(changed[number], layer).clone()
        field[0, 1, 5, 6] = 2.0
        changed[number] = replace(changed[number], **{layer: field})
        plan = planned(either, changed)
        assert_same(play(plan, changed), play(either, changed))
        assert plan.left_out["warp of history"] == 2


def test_no_dual_motion_where_no_pixel_can_be_uncovered(either):
    pan = moved(make_frames(4), [3.25, -1.5])
    plan = planned(either, pan)
    assert_same(play(plan, pan), play(either, pan))
    assert plan.left_out["warp of history"] == 0 and plan.left_out["dual motion"] == 3
    objects = make_frames(4)  # uncover the wall behind them
    plan = planned(either, objects)
    assert_same(play(plan, objects), play(either, objects))
    assert plan.left_out["dual motion"] == 0


def test_no_splat_where_no_pixel_can_be_uncovered(either):
    """Without motion_next, dual motion is made from motion, and differs from it no more than motion differs."""
    for speed, spread, left_out in ((3.25, 0.3, 3), (0.0, 0.0, 3), (3.25, 0.6, 0)):
        frames = [replace(f, motion_next=None) for f in moved(make_frames(4), [speed, 1.0 if speed else 0.0])]
        frames = [replace(f, motion=f.motion + spread * torch.rand(f.motion.shape)) for f in frames]
        plan = planned(either, frames)
        assert_same(play(plan, frames), play(either, frames))
        assert plan.left_out["dual motion"] == left_out


def test_a_first_frame_needs_no_running_means(either):
    frames = make_frames(3, H=45, W=61)
    for frame in frames:
        image, history = either.step(frame, None, Known(first=True))
        everything, expected = either.step(frame)
        assert_same(([image], history), ([everything], expected), close)
    plan = planned(either, frames)
    assert_same(play(plan, frames), play(either, frames))
    assert plan.left_out["running means"] == (history.mean is not None)


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_the_shipped_first_frame(precision, assert_images_close):
    model, frame = load(precision=precision), make_frames(1, H=90, W=122)[0]
    with torch.inference_mode():
        image, history = model.step(frame, None, Known(first=True))
        everything, expected = model.step(frame)
    row = "float32 tiles" if precision == "fp32" else "bfloat16 network"
    assert_images_close(image, everything, row)
    for name, tensor in history.layers().items():
        assert_images_close(tensor, expected.layers()[name], row)


def test_the_bound_for_dual_motion_never_promises_too_much():
    """Random fields around the threshold: whenever the bound says that nothing is uncovered, no mask has a pixel."""
    g, promised = torch.Generator().manual_seed(0), 0
    for _ in range(300):
        spread = torch.rand(1, generator=g) * 0.4
        motion = torch.randn(1, 2, 1, 1, generator=g) * 3 + spread * torch.rand(1, 2, 9, 11, generator=g)
        before = -motion.mean() + spread * torch.rand(1, 2, 9, 11, generator=g) - motion.amin((2, 3), keepdim=True)
        frame = replace(make_frames(1, H=9, W=11)[0], motion=motion)
        for motion_next in (before, -motion.flip(3)):
            if look(frame, motion_next).covered:
                promised += 1
                worst = (-motion_next.reshape(1, 2, 1, -1) - motion.reshape(1, 2, -1, 1)).norm(dim=1).max()
                assert worst <= 0.5 and not occlusion_mask(-motion_next, motion).any()
    assert promised > 20


def test_the_bound_holds_for_splatted_motion_next():
    """The same where motion_next is made from motion and depth."""
    g, promised = torch.Generator().manual_seed(0), 0
    for _ in range(200):
        spread = torch.rand(1, generator=g) * 0.8
        motion = torch.randn(1, 2, 1, 1, generator=g) * 3 + spread * torch.rand(1, 2, 9, 11, generator=g)
        frame = replace(make_frames(1, H=9, W=11)[0], motion=motion, depth=1 + torch.rand(1, 1, 9, 11, generator=g))
        if look(frame, None).covered:
            promised += 1
            before = splat_motion_next(motion, frame.depth, 1 + torch.rand(1, 1, 9, 11, generator=g))
            assert not occlusion_mask(dual_motion(motion, before), motion).any()
    assert promised > 20


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("convert", [lambda tensor: tensor, torch.Tensor.numpy], ids=["torch", "numpy"])
def test_motion_that_is_not_finite_promises_nothing(value, convert):
    (frame,) = moved(make_frames(1), [0.0, 0.0])
    broken = frame.motion.clone()
    broken[0, 1, 5, 6] = value
    for motion, before in ((broken, frame.motion), (broken, None), (frame.motion, broken), (broken, broken)):
        known = look(replace(frame, motion=motion).map(convert), before if before is None else convert(before))
        assert known == Known()


def sky(count, light=0.0, H=400):
    """The upper part of the picture is black, or evenly lit; the scene lies below."""
    frames = make_frames(count, H=H, W=32)
    above = torch.arange(H).reshape(1, 1, H, 1) < H - 40
    colour = torch.tensor([0.5, 0.7, 1.0]).reshape(1, 3, 1, 1) * light
    return [replace(f, radiance=torch.where(above, colour, f.radiance)) for f in frames]


@pytest.mark.parametrize("place", [0, -1])
def test_light_that_is_not_finite_is_examined_without_a_warning(place):
    image = np.ones((1, 3, 6, 8), np.float32)
    image[..., place, place] = np.inf
    with np.errstate(all="raise"):
        top, bottom, colour = varied_rows(image)
    assert (top, bottom) == ((0, 1) if place == 0 else (5, 6)) and (colour == 1).all()


def test_the_greatest_floats_are_examined_without_a_warning():
    frame = make_frames(1)[0].map(torch.Tensor.numpy)
    frame.normal[..., 0, 0] = frame.radiance[..., 0, :2] = 3e38
    with np.errstate(all="raise"):
        assert not are_encoded([frame])
        check_sign("frame", "light", frame.radiance)
        with pytest.raises(InputError, match="100 % of it is negative"):
            check_sign("frame", "light", -frame.radiance)


@pytest.mark.parametrize("light", [0.0, 1.7])
@pytest.mark.parametrize("below", [True, False])
def test_the_network_does_not_run_where_light_is_plain(denoiser, light, below):
    frames = sky(3, light) if below else [f.map(lambda tensor: tensor.flip(2)) for f in sky(3, light)]
    plan = planned(denoiser, frames)
    assert_same(play(plan, frames), play(denoiser, frames), close)
    assert plan.left_out["network in plain rows"] == 3
    plain = [replace(f, radiance=torch.zeros_like(f.radiance) + light) for f in frames]
    assert_same(play(planned(denoiser, plain), plain), play(denoiser, plain), close)


def test_light_does_not_seep_into_the_sky_for_ever():
    """A softmax has no zeros: each frame takes some light of the one before a kernel further, ever less of it."""
    model, frames = load("paper", precision="fp32"), sky(8, 1.7, H=640)
    plan = planned(model, frames)
    with torch.inference_mode():
        assert_same(play(plan, frames), play(model, frames), close)
    assert plan.left_out["network in plain rows"] == 8


def test_no_tile_of_the_sky_is_filtered(denoiser, monkeypatch):
    frames = sky(3, 1.7, H=500)
    monkeypatch.setattr("rtdenoise.run.plan.TILED_FROM", 1)
    plan, sizes, step = planned(denoiser, frames), [], denoiser.step
    plan._tiled.tile = 64
    expected = play(denoiser, frames)
    monkeypatch.setattr(denoiser, "step", lambda frame, *rest: sizes.append(frame.size) or step(frame, *rest))
    assert_same(play(plan, frames), expected, close)
    assert plan.left_out["network in plain rows"] == 3
    assert len(sizes) <= 3 * 3 and max(sizes) <= (64 + 2 * 128, 32)  # of 8 tiles a frame, with their halo


def test_a_colour_that_changes_is_filtered(denoiser):
    """The history has another colour than the frame, so it is not plain."""
    frames = [*sky(1, 1.0), *sky(2, 1.5)[1:]]
    plan = planned(denoiser, frames)
    assert_same(play(plan, frames), play(denoiser, frames), close)
    assert plan.left_out["network in plain rows"] == 1


def test_light_that_moves_into_the_dark_is_followed(denoiser):
    frames = sky(3)
    up = torch.tensor([0.0, 150.0]).reshape(1, 2, 1, 1).expand_as(frames[0].motion)
    frames[1] = replace(frames[1], motion=up, motion_next=-up)
    assert_same(play(planned(denoiser, frames), frames), play(denoiser, frames), close)


@pytest.mark.parametrize("layer", ["motion", "motion_next"])
def test_a_single_frame_needs_no_motion(denoiser, layer):
    (frame,) = make_frames(1)
    image = denoiser.step(frame)[0]
    assert torch.equal(denoiser.step(replace(frame, **{layer: None}))[0], image)


@pytest.mark.parametrize(("motion", "read"), [("dual", {"motion_next"}), ("traditional", set()), (None, set())])
def test_of_a_single_frame_only_what_a_frame_after_it_needs_is_read(motion, read):
    (frame,) = make_frames(1)
    assert {"motion", "motion_next"} & {*make_plan(frame.size, 1, motion, [frame]).layers} == read


def test_traditional_motion_needs_no_motion_next():
    model, frames = TemporalKPN(replace(TINY, motion="traditional")).eval(), make_frames(3)
    assert "motion_next" not in make_plan(frames[0].size, 3, "traditional", frames).layers
    with torch.inference_mode():
        without = play(model, [replace(f, motion_next=None) for f in frames])[0]
        assert all(torch.equal(a, b) for a, b in zip(without, play(model, frames)[0], strict=True))


def test_layers_that_are_not_needed_are_not_read(tmp_path, monkeypatch):
    sequence = open_sequence(write_sequence(tmp_path / "shot", make_frames(1)))
    names = []
    read = type(sequence.files[0]).read
    monkeypatch.setattr(type(sequence.files[0]), "read", lambda self, asked: names.extend(asked) or read(self, asked))
    frame = sequence.only(("radiance", "albedo", "normal", "depth"))[0]
    assert frame.motion is None and not any(name.startswith("motion") for name in names)


def test_tiles_are_the_whole_picture(either):
    """Whatever the motion: objects, leaps beyond a tile, off the screen."""
    frames = make_frames(4, H=70, W=150)
    frames[2].motion[:, 0, 20:30] = 90.0
    frames[2].motion[:, 1, 40:50] = OFF_SCREEN
    assert_same(play(Tiled(either, 32), frames), play(either, frames), close)
    without = [replace(f, motion_next=None) for f in frames]
    assert_same(play(Tiled(either, 32), without), play(either, without), close)


@pytest.mark.parametrize("name", available())
def test_tiles_of_the_shipped_models(name):
    frames = make_frames(2, H=32, W=420)
    with torch.inference_mode():
        model = load(name, precision="fp32")
        assert_same(play(Tiled(model, 64), frames), play(model, frames), close)


def test_the_plan_is_in_the_summary_and_can_be_switched_off(tmp_path):
    shot = write_sequence(tmp_path / "shot", moved(make_frames(4), [0.0, 0.0]))
    options = Options(model=str(save_tiny(tmp_path)), float32=True)
    summary = denoise(str(shot), tmp_path / "planned", options)
    everything = denoise(str(shot), tmp_path / "everything", replace(options, plan=False))
    assert summary.left_out["warp of history"] == 3 and everything.left_out == {} and everything.plan is None
    for one, other in zip(open_sequence(tmp_path / "planned"), open_sequence(tmp_path / "everything"), strict=True):
        assert np.array_equal(one.radiance, other.radiance)
