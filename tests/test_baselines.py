"""The baselines by their definitions; SVGF and TRMV are in test_svgf.py."""

import math
from dataclasses import replace

import pytest
import torch
from synthetic import make_frames

from rtdenoise.baselines import Accumulate, Oidn
from rtdenoise.baselines.clamp import clamp_to_neighbourhood
from rtdenoise.errors import InputError


def test_accumulation_is_the_running_mean_until_alpha():
    method, history = Accumulate(alpha=0.25), None
    frames = [frame.map(lambda t: t) for frame in make_frames(4)]
    wall = (slice(None), slice(None), slice(18, 24))  # where nothing moves
    for i, frame in enumerate(frames):
        image, history = method.step(frame, history)
        mean = torch.stack([f.radiance for f in frames[: i + 1]]).mean(0)
        torch.testing.assert_close(image[wall], mean[wall])
        assert history.length[0, 0, 20, 20] == i + 1
    image, _ = method.step(frames[0], history)
    expected = 0.25 * frames[0].radiance + 0.75 * history.radiance
    torch.testing.assert_close(image[wall], expected[wall])


def test_accumulation_starts_anew_off_the_screen():
    method = Accumulate()
    first, second = make_frames(2)
    _, history = method.step(first)
    away = second.motion + 1e4
    image, history = method.step(second.map(lambda t: away if t is second.motion else t), history)
    assert torch.equal(image, second.radiance) and history.length.max() == 1


def test_a_history_that_cannot_be_fetched_is_one_line():
    method = Accumulate()
    first, second = make_frames(2)
    _, history = method.step(replace(first, albedo=None, normal=None))
    with pytest.raises(InputError, match="layer motion is missing"):
        method.step(replace(second, motion=None), history)
    with pytest.raises(InputError, match="pass history=None to start anew"):
        method.step(second.crop(0, 0, 8, 8), history)


@pytest.mark.parametrize("quality", ["high", "fast"])
def test_oidn_denoises_and_keeps_the_exposure(quality):
    frame = make_frames(1, H=64, W=96)[0]
    image, history = Oidn(quality).step(frame)
    assert history is None and image.shape == frame.radiance.shape
    before, after = ((x - frame.reference).square().mean() for x in (frame.radiance, image))
    assert after < 0.1 * before
    assert image.mean().item() == pytest.approx(frame.reference.mean().item(), rel=0.1)


def test_oidn_filters_what_is_accumulated_or_accumulates_what_is_filtered():
    frames, alpha = make_frames(3, H=64, W=96), 0.5
    plain, before, after = Oidn(), Oidn(accumulate="input", alpha=alpha), Oidn(accumulate="output", alpha=alpha)
    histories = [None] * 4
    for frame in frames:
        running, histories[0] = Accumulate(alpha).step(frame, histories[0])
        filtered, _ = plain.step(frame)
        expected, histories[1] = Accumulate(alpha).step(replace(frame, radiance=filtered), histories[1])
        image, histories[2] = before.step(frame, histories[2])
        torch.testing.assert_close(image, plain.step(replace(frame, radiance=running))[0])
        image, histories[3] = after.step(frame, histories[3])
        torch.testing.assert_close(image, expected)


def test_oidn_prefilters_noisy_guides_and_takes_frames_of_another_size():
    frame = make_frames(1, H=64, W=96)[0]
    g = torch.Generator().manual_seed(3)
    noisy = replace(frame, albedo=(frame.albedo + 0.3 * torch.randn(frame.albedo.shape, generator=g)).clamp(0, 1))
    method = Oidn(prefilter=True)
    errors = [(x.step(noisy)[0] - frame.reference).square().mean() for x in (method, Oidn())]
    assert errors[0] < errors[1]
    smaller = frame.crop(0, 0, 48, 80)
    torch.testing.assert_close(method.step(smaller)[0], Oidn(prefilter=True).step(smaller)[0])
    apart = Oidn(clean=True)  # features filtered once, for several pictures
    assert torch.equal(apart.step(apart.prefiltered(smaller))[0], method.step(smaller)[0])


def test_clamping_pulls_history_into_the_range_of_the_neighbourhood():
    current = torch.tensor([0.0, 2.0]).repeat(1, 3, 6, 3)  # columns of 0 and 2
    history = torch.full_like(current, 50.0)
    clamped = clamp_to_neighbourhood(history, current, sigmas=2.0, window=3)
    mean, deviation = 4 / 3, math.sqrt(8 / 3 - (4 / 3) ** 2)  # two columns of 2, one of 0
    assert clamped[0, 0, 3, 2].item() == pytest.approx(mean + 2 * deviation)
    inside = torch.full_like(current, 1.0)
    assert torch.equal(clamp_to_neighbourhood(inside, current, sigmas=2.0, window=3), inside)


def test_clamped_accumulation_leaves_no_ghost_in_a_noiseless_sequence():
    frames = make_frames(5, noise=0.0)
    flat = [replace(f, radiance=torch.where(f.depth < 5, 9.0, 1.0).expand(1, 3, 24, 32)) for f in frames]
    strip = (slice(None), slice(None), slice(8, 14), slice(8, 11))  # uncovered, and not next to the square
    images = {}
    for name, method in {"plain": Accumulate(), "clamped": Accumulate(clamp=1.0)}.items():
        history = None
        for frame in flat:
            images[name], history = method.step(frame, history)
    assert images["plain"][strip].max() > 2
    torch.testing.assert_close(images["clamped"][strip], torch.ones(1, 3, 6, 3))
