"""What the plan leaves out changes nothing: to the bit, or within the tolerance of float32."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import TINY, make_frames, write_sequence

from rtdenoise.data.sequences import open_sequence
from rtdenoise.denoise import Options, denoise
from rtdenoise.frame import OFF_SCREEN
from rtdenoise.models import TemporalKPN, accumulated_kpn, available, create, load, save
from rtdenoise.models.presets import architecture
from rtdenoise.motion import occlusion_mask
from rtdenoise.plan import Planned, make_plan
from rtdenoise.tiles import Tiled, light_reach, network_reach


@pytest.fixture(scope="module")
def denoiser():
    torch.manual_seed(0)
    return TemporalKPN(TINY).eval().requires_grad_(False)


@pytest.fixture(scope="module", params=[TINY, accumulated_kpn.Config(widths=(4, 4, 4, 4), scales=4)], ids=architecture)
def either(request):
    """Of each architecture, one that runs in no time."""
    torch.manual_seed(0)
    return create(request.param).eval().requires_grad_(False)


def planned(denoiser, frames):
    return Planned(denoiser, make_plan(frames[0].size, len(frames), denoiser.config.motion, frames[:3]))


def play(denoiser, frames):
    history, images = None, []
    for frame in frames:
        image, history = denoiser.step(frame, history)
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
    assert plan.left_out == {"warp of history": 0, "dual motion": 3, "network in black rows": 0}
    objects = make_frames(4)  # uncover the wall behind them
    plan = planned(either, objects)
    assert_same(play(plan, objects), play(either, objects))
    assert plan.left_out["dual motion"] == 0


def test_the_bound_for_dual_motion_never_promises_too_much():
    """Random fields around the threshold: whenever the bound says that nothing is uncovered, no mask has a pixel."""
    from rtdenoise.plan import _covered

    g, promised = torch.Generator().manual_seed(0), 0
    for _ in range(300):
        spread = torch.rand(1, generator=g) * 0.4
        motion = torch.randn(1, 2, 1, 1, generator=g) * 3 + spread * torch.rand(1, 2, 9, 11, generator=g)
        before = -motion.mean() + spread * torch.rand(1, 2, 9, 11, generator=g) - motion.amin((2, 3), keepdim=True)
        frame = replace(make_frames(1, H=9, W=11)[0], motion=motion)
        for motion_next in (before, -motion.flip(3)):
            if _covered(frame, motion_next):
                promised += 1
                worst = (-motion_next.reshape(1, 2, 1, -1) - motion.reshape(1, 2, -1, 1)).norm(dim=1).max()
                assert worst <= 0.5 and not occlusion_mask(-motion_next, motion).any()
    assert promised > 20


def dark_sky(count, H=400):
    """The upper part of the picture is black; the scene lies below."""
    frames = make_frames(count, H=H, W=32)
    night = torch.arange(H).reshape(1, 1, H, 1) < H - 40
    return [replace(f, radiance=torch.where(night, 0.0, f.radiance)) for f in frames]


def test_the_network_does_not_run_where_no_light_reaches(denoiser):
    frames = dark_sky(3)
    plan = planned(denoiser, frames)
    assert_same(play(plan, frames), play(denoiser, frames), close)
    assert plan.left_out["network in black rows"] == 3
    image = play(plan, frames)[0][-1]
    assert (image[:, :, :256] == 0).all() and (play(denoiser, frames)[0][-1][:, :, :256] == 0).all()
    black = [replace(f, radiance=torch.zeros_like(f.radiance)) for f in frames]
    assert_same(play(planned(denoiser, black), black), play(denoiser, black))


def test_light_that_moves_into_the_dark_is_followed(denoiser):
    frames = dark_sky(3)
    up = torch.tensor([0.0, 150.0]).reshape(1, 2, 1, 1).expand_as(frames[0].motion)
    frames[1] = replace(frames[1], motion=up, motion_next=-up)
    assert_same(play(planned(denoiser, frames), frames), play(denoiser, frames), close)


@pytest.mark.parametrize("layer", ["motion", "motion_next"])
def test_a_single_frame_needs_no_motion(denoiser, layer):
    (frame,) = make_frames(1)
    plan = make_plan(frame.size, 1, "dual", [frame])
    assert layer not in plan.layers
    image = denoiser.step(frame)[0]
    assert torch.equal(denoiser.step(replace(frame, **{layer: None}))[0], image)


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


def test_reach_is_what_the_layers_say():
    """Four levels of two 3×3 convolutions each way: 2·(1 + 2 + 4)·2 + 2·8 pixels, and what pooling and kernels add."""
    assert 44 + 32 <= network_reach(TemporalKPN(TINY)) <= 128
    assert light_reach(TemporalKPN(TINY)) == 32


@pytest.mark.parametrize("name", available())
def test_tiles_of_the_shipped_models(name):
    frames = make_frames(2, H=64, W=420)
    with torch.inference_mode():
        model = load(name, precision="fp32")
        assert_same(play(Tiled(model, 64), frames), play(model, frames), close)


def test_the_plan_is_in_the_summary_and_can_be_switched_off(tmp_path):
    torch.manual_seed(0)
    save(TemporalKPN(TINY), tmp_path / "tiny.safetensors")
    shot = write_sequence(tmp_path / "shot", moved(make_frames(4), [0.0, 0.0]))
    options = Options(model=str(tmp_path / "tiny.safetensors"), float32=True)
    summary = denoise(str(shot), tmp_path / "planned", options)
    everything = denoise(str(shot), tmp_path / "everything", replace(options, plan=False))
    assert summary.left_out["warp of history"] == 3 and everything.left_out == {} and everything.plan is None
    for one, other in zip(open_sequence(tmp_path / "planned"), open_sequence(tmp_path / "everything"), strict=True):
        assert np.array_equal(one.radiance, other.radiance)
