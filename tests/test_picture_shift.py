"""Light that moves over its surface and has noise: followed in denoised pictures, for the next frame."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import assert_goes_on, behind_glass, write_sequence

from rtdenoise import models
from rtdenoise.constants import SHIFT_CELL, SHIFT_GREATEST
from rtdenoise.data.stored import read_history, write_history
from rtdenoise.errors import InputError
from rtdenoise.frame import History, Known
from rtdenoise.models import AccumulatedKPNConfig
from rtdenoise.models.moved_light import shifted
from rtdenoise.run.denoise import Options
from rtdenoise.run.tiles import Tiled
from rtdenoise.shift import picture

H, W = 96, 144
SMALL = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3, footprint=True)


def denoised(x=0.0, y=0.0, noise=0.0, seed=0):
    """A smooth picture `[1, 3, H, W]`, moved by (x, y) pixels."""
    rows, columns = torch.meshgrid(torch.arange(H) - y, torch.arange(W) - x, indexing="ij")
    light = 1 + 0.5 * (0.3 * columns).sin() * (0.4 * rows).cos() + 0.3 * (0.17 * (rows + 2 * columns)).sin()
    light = light + noise * torch.randn(H, W, generator=torch.Generator().manual_seed(seed))
    return light.expand(1, 3, H, W).clamp(min=0)


def before(image, found=None):
    return History(image, None, torch.full((1, 1, H, W), 4.0), None, found=found)


def found(now, then, expected=None, motion=(0.0, 0.0), depth=4.0):
    motion = torch.tensor(motion).reshape(1, 2, 1, 1).expand(1, 2, H, W)
    return picture.find(now, motion, torch.full((1, 1, H, W), depth), before(then, expected))


@pytest.mark.parametrize("speed", [(0.5, 0.0), (-0.8, 0.3), (0.0, -0.6), (1.0, 0.0)])
def test_a_moving_picture_is_followed_at_once(speed):
    shift, told = found(denoised(*speed), denoised())
    inner = shift[..., 1:-1, 1:-1]
    assert inner[:, 0].mean().item() == pytest.approx(-speed[0], abs=0.08)
    assert inner[:, 1].mean().item() == pytest.approx(-speed[1], abs=0.08)
    assert torch.equal(shift, told)


def test_what_moves_as_motion_says_has_no_shift():
    shift, _ = found(denoised(2.5, -1.0), denoised(), motion=(-2.5, 1.0))
    assert not shift[..., 1:-1, 1:-1].any()


def test_pictures_that_differ_by_noise_have_no_shift():
    for seed in range(3):
        shift, told = found(denoised(noise=0.1, seed=seed), denoised(noise=0.1, seed=seed + 10))
        assert (shift != 0).float().mean() < 0.05 and not told.any()


def test_longer_shifts_count_as_mistakes():
    shift, _ = found(denoised(3.0, 2.0), denoised())
    assert shift.norm(dim=1).max() < SHIFT_GREATEST


def test_another_surface_has_no_shift():
    shift, _ = found(denoised(0.5), denoised(), depth=8.0)
    assert not shift.any()


def test_what_explains_little_counts_where_two_frames_agree():
    now, then = denoised(0.4, noise=0.085, seed=1), denoised(noise=0.085, seed=2)
    shift, alone = found(now, then, torch.zeros(1, 2, H // SHIFT_CELL, W // SHIFT_CELL))
    half_sure = (shift != 0).any(1) & (alone == 0).all(1)
    assert half_sure.any()
    _, agreed = found(now, then, shift)
    assert torch.equal(agreed, shift)
    _, opposed = found(now, then, -shift)
    assert torch.equal(opposed, alone)


def test_the_next_frame_finds_it_where_the_surface_has_gone():
    shift = torch.zeros(1, 2, H // SHIFT_CELL, W // SHIFT_CELL)
    shift[:, 0, 2, 3] = 0.5
    motion = torch.tensor([-2.0 * SHIFT_CELL, 0.0]).reshape(1, 2, 1, 1).expand(1, 2, H, W)
    moved = picture.moved(shift, motion, torch.full((1, 1, H, W), 4.0))
    rows, columns = (slice(n * SHIFT_CELL, (n + 1) * SHIFT_CELL) for n in (2, 5))
    assert moved[0, 0, rows, columns].min() > 0.1
    moved[..., rows, columns] = 0
    assert not moved.any()


def test_edges_of_surfaces_and_what_was_off_the_screen_take_none():
    shift, depth = torch.full((1, 2, H // SHIFT_CELL, W // SHIFT_CELL), 0.5), torch.full((1, 1, H, W), 4.0)
    depth[..., W // 2 :] = 40.0
    moved = picture.moved(shift, torch.zeros(1, 2, H, W), depth)
    assert not moved[..., W // 2 - 2 : W // 2 + 2].any() and moved[..., : W // 2 - 8].all()
    assert not picture.moved(shift, torch.full((1, 2, H, W), 1e4), depth).any()
    assert picture.moved(torch.zeros_like(shift), torch.zeros(1, 2, H, W), depth) is None


@pytest.mark.parametrize("value", [0.0, 1e-20, 1e15], ids=["black", "almost black", "brightest"])
def test_extreme_light_is_finite(value):
    shift, told = found(denoised(0.5) * value, denoised() * value)
    assert shift.isfinite().all() and told.isfinite().all()


@pytest.mark.parametrize("size", [(1, 1), (17, 5), (20, 40)])
def test_any_size(size):
    image, depth = torch.rand(1, 3, *size), torch.ones(1, 1, *size)
    history = History(torch.rand(1, 3, *size), None, depth, None)
    for _ in range(2):
        shift, told = picture.find(image, torch.zeros(1, 2, *size), depth, history)
        assert shift.shape[2:] == tuple(-(-n // SHIFT_CELL) for n in size) == told.shape[2:]
        history = replace(history, found=shift)


def noisy(count):
    """Behind glass, without any light that has no noise."""
    return behind_glass(count, noise=0.5)


@torch.no_grad()
@pytest.mark.parametrize("name", ["default", "hybrid-fast"])
def test_a_noisy_window_behind_glass_is_followed(name):
    network, history, shifts = models.load(name, "cpu", "fp32"), None, []
    for number, frame in enumerate(noisy(9)):
        if number > 4:
            shifts.append(shifted(frame, history, Known()).shift)
        _, history = network.step(frame, history)
    shift = torch.cat(shifts)
    there = shift.ne(0).any(1)
    assert there.float().mean() > 0.5
    assert shift[:, 0][there].mean().item() == pytest.approx(-0.5, abs=0.12)
    assert shift[:, 1][there].mean().item() == pytest.approx(0.0, abs=0.12)


@torch.no_grad()
def test_tiles_are_seamless():
    network, frames = models.load("default", "cpu", "fp32"), noisy(6)
    whole, tiled, tiles = None, None, Tiled(network, 64)
    for frame in frames:
        a, whole = network.step(frame, whole)
        b, tiled = tiles.step(frame, tiled)
        torch.testing.assert_close(a, b, atol=2e-3, rtol=1e-3)
    assert whole.shifts[0].any()
    torch.testing.assert_close(whole.shifts, tiled.shifts, atol=2e-3, rtol=0)


@pytest.mark.parametrize("recent", [0, 3])
def test_an_interrupted_run_goes_on_to_the_bit(tmp_path, recent):
    """With the shifts of recent frames, which no file of the sequence holds."""
    network = models.load("default", "cpu", "fp32")
    network.config = replace(network.config, recent=recent)
    models.save(network, tmp_path / "w.safetensors")
    shot = write_sequence(tmp_path / "shot", noisy(8))
    options = Options(model=str(tmp_path / "w.safetensors"), precision="fp32", float32=True)
    assert_goes_on(shot, tmp_path, options, 6)


@torch.no_grad()
@pytest.mark.parametrize("field", ["found", "shifts.0"])
def test_a_stored_shift_of_another_size_is_refused(tmp_path, field):
    network, history = models.create(SMALL).eval(), None
    for frame in noisy(2):
        _, history = network.step(frame, history)
    layers = replace(history, recent=()).layers()
    fields = {name: tensor.contiguous().numpy() for name, tensor in layers.items()}
    write_history(tmp_path / "h", fields, {})
    assert read_history(tmp_path / "h")[0].keys() == fields.keys()
    write_history(tmp_path / "h", fields | {field: np.zeros((1, 2, 3, 3), np.float32)}, {})
    with pytest.raises(InputError, match=field):
        read_history(tmp_path / "h")
