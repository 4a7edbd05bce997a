"""Light that moves over its surface, as behind glass: found where it has no noise, followed, never invented."""

from dataclasses import replace

import pytest
import torch
from synthetic import assert_goes_on, behind_glass, write_sequence

from rtdenoise import models, ops
from rtdenoise.constants import SHIFT_GREATEST
from rtdenoise.frame import Known
from rtdenoise.models import AccumulatedKPNConfig, past
from rtdenoise.models.moved_light import shifted
from rtdenoise.run.denoise import Options
from rtdenoise.run.tiles import Tiled
from rtdenoise.shift.light import light_shift

H, W = 96, 144  # of frames behind glass
SMALL = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3, footprint=True)


def found(frames):
    before, frame = frames
    return light_shift(frame.radiance, before.radiance, frame.motion, frame.depth, before.depth)


@pytest.mark.parametrize("speed", [(0.5, 0.0), (-0.8, 0.0), (0.0, 0.6), (0.4, -0.5)])
def test_a_window_behind_glass_is_followed(speed):
    shift = found(behind_glass(speed=speed))
    moved = shift.abs().sum(1) > 0
    assert moved.float().mean() > 0.9
    for axis in (0, 1):  # motion leads backwards
        each = shift[:, axis][moved]
        assert each.mean().item() == pytest.approx(-speed[axis], abs=0.08)
        assert each.std() < 0.1


@pytest.mark.parametrize("seed", range(3))
def test_light_that_stays_on_its_surface_has_no_shift(seed):
    """Its edges are ragged all the same: one sample a pixel."""
    shift = found(behind_glass(speed=(0.0, 0.0), seed=seed))
    assert shift is None or (shift != 0).any(1).float().mean() < 0.01


def test_what_moves_as_motion_says_has_no_shift():
    before, frame = behind_glass(speed=(0.5, 0.0))
    shift = found((before, replace(frame, motion=torch.tensor([-0.5, 0.0]).reshape(1, 2, 1, 1).repeat(1, 1, H, W))))
    assert shift is None or (shift != 0).any(1).float().mean() < 0.01


def test_noisy_light_is_not_looked_at():
    assert found(behind_glass(noise=0.3)) is None


def test_edges_of_surfaces_are_not_looked_at():
    """The bars stand in the room, and motion is theirs: nothing is behind glass."""
    frames = behind_glass()
    frames = [replace(f, depth=torch.where(f.radiance[:, :1] > 5, 40.0, 4.0)) for f in frames]
    assert found(frames) is None


def test_long_shifts_are_left_alone():
    shift = found(behind_glass(speed=(5.0, 3.0)))
    assert shift.norm(dim=1).max() < SHIFT_GREATEST


@pytest.mark.parametrize("value", [0.0, 1e-20, 1e15], ids=["black", "almost black", "brightest"])
def test_extreme_light_is_finite(value):
    frames = [replace(f, radiance=(f.radiance * value).clamp(max=1e15)) for f in behind_glass()]
    shift = found(frames)
    assert shift is None or shift.isfinite().all()


@pytest.mark.parametrize("value", [1e4, -1e4, 3e38], ids=["right", "left", "beyond"])
def test_motion_off_the_screen_has_no_shift(value):
    before, frame = behind_glass()
    assert found((before, replace(frame, motion=torch.full_like(frame.motion, value)))) is None


def test_a_batch_is_its_pictures():
    pairs = [behind_glass(speed=speed) for speed in ((0.5, 0.0), (0.0, 0.6))]
    both = [replace(a, **{n: torch.cat([t, u]) for (n, t), (_, u) in zip(a.layers(), b.layers(), strict=True)})
            for a, b in zip(*pairs, strict=True)]  # fmt: skip
    torch.testing.assert_close(found(both), torch.cat([found(pair) for pair in pairs]))


def test_plain_and_fused_agree():
    frames = behind_glass()
    with ops.use("plain"):
        plain = found(frames)
    torch.testing.assert_close(found(frames), plain, atol=1e-3, rtol=0)


def played(step, frames):
    images, history = [], None
    for frame in frames:
        image, history = step(frame, history)
        images.append(image)
    return images


@torch.no_grad()
def test_history_behind_glass_is_where_the_light_is(monkeypatch):
    """Recent frames average the window's own light; without the shift its bars fill up, unless history gives way."""
    monkeypatch.setattr(past, "outdated", lambda found, agree, frames: torch.zeros_like(agree))
    network, frames = models.create(SMALL).eval(), behind_glass(5)
    rest = torch.stack([f.radiance for f in behind_glass(64, speed=(0.0, 0.0), seed=1)]).mean(0)

    def error(known):
        history = None
        for frame in frames:
            _, history = network.step(frame, history, known)
        there = history.footprint[:, :3].roll(-2, dims=3)  # four steps of half a pixel
        return (there - rest)[..., 8:-8, 8:-8].square().mean()

    assert error(Known()) < 0.7 * error(Known(shift=torch.zeros(1, 2, H, W)))


@torch.no_grad()
@pytest.mark.parametrize("name", ["default", "hybrid-fast"])
def test_tiles_are_seamless(name):
    network, frames = models.load(name, "cpu", "fp32"), behind_glass(4)
    assert shifted(frames[1], network.step(frames[0])[1], Known()).shift is not None
    for a, b in zip(played(network.step, frames), played(Tiled(network, 64).step, frames), strict=True):
        torch.testing.assert_close(a, b, atol=2e-3, rtol=1e-3)


@pytest.mark.parametrize("recent", [0, 3])
def test_an_interrupted_run_goes_on_to_the_bit(tmp_path, recent):
    models.save(models.create(replace(SMALL, recent=recent, footprint=recent > 0)), tmp_path / "w.safetensors")
    shot = write_sequence(tmp_path / "shot", behind_glass(7))
    options = Options(model=str(tmp_path / "w.safetensors"), precision="fp32", float32=True)
    assert_goes_on(shot, tmp_path, options, 5)
