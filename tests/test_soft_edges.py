"""Silhouettes of one sample a pixel before nothing (`data.soft_edges`)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rtdenoise.data.opening import open_sequence
from rtdenoise.data.soft_edges import with_soft_edges
from rtdenoise.frame import OFF_SCREEN, Frame
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

H, W = 40, 56
SHOT = Path(__file__).parent / "data" / "cycles"


def disc(behind=0.0, speed=OFF_SCREEN, noise=0.0):
    """A bright disc, as one sample a pixel sees it, and as it is. The background moves by `speed` against it."""
    draw = np.random.default_rng(1)
    y, x = np.mgrid[:H, :W]

    def hits(n):
        u, v = draw.random((2, n, H, W))
        return np.hypot(x + u - 27.2, y + v - 19.6) < 13

    hit, exact = hits(1)[0], hits(2048).mean(0)
    colour = np.array([4.0, 2.0, 0.5])[:, None, None] * (1 + noise * draw.normal(size=(3, H, W)).clip(-2, 2))
    radiance = np.where(hit, colour, behind)[None].astype(np.float32)
    depth = np.where(hit, 3.0, 0.0)[None, None].astype(np.float32)
    motion = np.where(hit, 0.0, speed)[None, None].repeat(2, 1).astype(np.float32)
    truth = np.array([4.0, 2.0, 0.5])[:, None, None] * exact + behind * (1 - exact)
    return Frame(radiance, depth=depth, motion=motion), truth, exact


def error(frame, truth, where):
    return np.sqrt(np.square(frame.radiance[0] - truth)[:, where].mean())


@pytest.mark.parametrize("behind", [0.0, 1.5])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_silhouette_comes_nearer_to_the_true_one(behind, noise):
    frame, truth, exact = disc(behind, noise=noise)
    mixed = (exact > 0) & (exact < 1)
    assert error(with_soft_edges(frame), truth, mixed) < 0.75 * error(frame, truth, mixed)


def test_a_slanted_line_two_pixels_wide_is_as_wide_all_along():
    """Not in stretches alone: it would look like a string of beads, which crawl as it moves."""
    def hits(offsets):
        return np.abs(x + offsets[0] - 26.0 - 0.15 * (y + offsets[1] - H / 2)) < 1.15

    draw = np.random.default_rng(2)
    y, x = np.mgrid[:H, :W]
    hit, exact = hits(draw.random((2, H, W))), np.mean([hits(pair) for pair in draw.random((2048, 2))], axis=0)
    frame = Frame(4.0 * hit[None, None].repeat(3, 1).astype(np.float32), depth=hit[None, None].astype(np.float32))
    soft = with_soft_edges(frame).radiance[0, 0]
    rows = slice(4, -4)
    width, wanted = soft[rows].sum(1), 4 * exact[rows].sum(1)
    assert np.abs(width - wanted).mean() < 0.8 * np.abs(frame.radiance[0, 0, rows].sum(1) - wanted).mean()
    softened = (soft != frame.radiance[0, 0])[rows].any(1)
    assert softened.all()


def test_all_else_stays_to_the_bit():
    frame, *_ = disc(noise=0.3)
    y, x = np.mgrid[:H, :W] + 0.5
    away = np.abs(np.hypot(x - 27.2, y - 19.6) - 13) > 3
    soft = with_soft_edges(frame)
    assert np.array_equal(soft.radiance[..., away], frame.radiance[..., away]) and soft.radiance.dtype == np.float32
    assert all(np.array_equal(getattr(soft, name), getattr(frame, name)) for name in ("depth", "motion"))


@pytest.mark.parametrize("kind", ["one speed", "no sky", "no depth", "fur"])
def test_frames_without_such_edges_come_back_as_they_are(kind):
    frame, *_ = disc(speed=0.3 if kind == "one speed" else OFF_SCREEN)
    if kind == "no sky":
        frame = replace(frame, depth=np.ones_like(frame.depth))
    if kind == "fur":
        frame = replace(frame, depth=np.indices((H, W))[1][None, None].astype(np.float32) % 3)
    if kind == "no depth":
        frame = replace(frame, depth=None)
    assert with_soft_edges(frame) is frame


def test_without_motion_all_silhouettes_are_meant():
    frame, *_ = disc()
    assert np.array_equal(with_soft_edges(replace(frame, motion=None)).radiance, with_soft_edges(frame).radiance)


def test_a_firefly_does_not_spread():
    frame, *_ = disc()
    quiet = with_soft_edges(frame).radiance
    y, x = np.argwhere((frame.depth[0, 0] > 0) & (np.pad(frame.depth[0, 0], 1)[1:-1, :-2] == 0))[5]
    frame.radiance[..., y, x] = 1e5
    loud = with_soft_edges(frame).radiance
    changed = np.abs(loud - quiet).max((0, 1))
    changed[y, x] = 0
    assert changed.max() < 20  # of 100000: a mean would spread some 5000


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1.0, 3e38])
def test_broken_pixels_break_no_others(bad):
    frame, *_ = disc()
    y, x = np.argwhere(frame.depth[0, 0] > 0)[0]
    frame.radiance[..., y, x] = bad
    soft = with_soft_edges(frame).radiance
    assert np.array_equal(soft[..., y, x], frame.radiance[..., y, x], equal_nan=True)
    soft[..., y, x] = 0
    assert (soft >= 0).all() and soft.max() < 20


@pytest.mark.parametrize("scale", [1e-20, 1e-3, 1e9])
def test_exposure_changes_nothing(scale):
    frame, *_ = disc(noise=0.3)
    scaled = with_soft_edges(replace(frame, radiance=frame.radiance * np.float32(scale)))
    assert np.allclose(scaled.radiance / scale, with_soft_edges(frame).radiance, rtol=1e-4, atol=1e-5)


def test_denoisers_read_frames_of_one_sample_from_cycles_so(tmp_path):
    def soft(**options):
        return open_chosen(str(SHOT), Options(model="fast", **options))[0].soft_edges

    noted = open_sequence(SHOT).header.samples
    assert soft(samples=1) and not soft(samples=4) and not soft(samples=1, signal="indirect")
    assert soft() == (noted == 1) and not open_sequence(SHOT).soft_edges
