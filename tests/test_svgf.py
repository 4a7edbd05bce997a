"""SVGF and TRMV: variance, edges, history, and a lower error than plain accumulation."""

import math
from dataclasses import replace

import pytest
import torch
from synthetic import make_frames, with_bad_pixels

from rtdenoise.baselines import Svgf, Trmv
from rtdenoise.baselines.atrous import SPLINE, Surface, atrous, gaussian
from rtdenoise.baselines.svgf import estimate_variance, kind_of
from rtdenoise.color import luminance
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.evaluate import evaluate, uncovered
from rtdenoise.evaluate.demo import SAMPLE
from rtdenoise.frame import Frame, stack

WALL, SQUARE = 2.0, 10.0  # irradiance of the wall and of the square that passes before it by 2 px a frame
# Pixels of frame 5 that the square hid in frame 4 with all their neighbours, so that the 3×3 search finds nothing.
HIDDEN = (slice(None), slice(None), slice(7, 15), slice(15, 16))


def flat(radiance, depth=5.0):
    """A frame of one wall, seen head-on by a camera at rest."""
    one = torch.ones_like(radiance[:, :1])
    return Frame(
        radiance=radiance,
        albedo=torch.full_like(radiance, 0.5),
        normal=torch.cat([0 * one, 0 * one, one], dim=1),
        depth=depth * one,
        motion=torch.zeros_like(radiance[:, :2]),
        motion_next=torch.zeros_like(radiance[:, :2]),
    )


def moving_square(count, noise=0.0):
    """`make_frames` with a normal on the wall and different light on the square."""
    frames = []
    for frame in make_frames(count, noise=noise):
        light = torch.where(frame.depth < 5, SQUARE, WALL)
        facing = torch.tensor([0.0, 0.0, 1.0]).reshape(1, 3, 1, 1).expand_as(frame.normal)
        frames.append(replace(frame, radiance=frame.radiance / 2 * light, normal=facing))
    return frames


def run(method, frames):
    history = None
    for frame in frames:
        image, history = method.step(frame, history)
    return image, history


def surface_of(frame):
    return Surface.of(frame.depth, frame.normal, kind_of(frame), sigma_z=1.0, sigma_n=64.0)


@pytest.mark.parametrize(
    ("alpha", "count", "share"),
    [(0.0, 2, 1 / 2), (0.0, 8, 1 / 8), (0.0, 24, 1 / 24), (0.2, 30, 0.2 / (2 - 0.2))],
)
def test_variance_of_white_noise_falls_as_that_of_the_mean(alpha, count, share):
    frames = [flat(1 + 0.2 * torch.randn(1, 3, 48, 48).clamp(-4, 4)) for _ in range(count)]
    variance_of_one = luminance(torch.cat([f.radiance / 0.5 for f in frames])).var()
    _, state = run(Svgf(alpha=alpha), frames)
    estimate = estimate_variance(state.moments, state.length, state.spread, surface_of(frames[0]))
    assert estimate.mean().item() == pytest.approx(share * variance_of_one.item(), rel=0.1)


def test_the_first_frame_takes_its_variance_from_the_neighbourhood():
    frame = flat(1 + 0.2 * torch.randn(1, 3, 48, 48))
    light = luminance(frame.radiance)
    one = torch.ones_like(light)
    estimate = estimate_variance(torch.cat([light, light.square()], dim=1), one, one, surface_of(frame))
    assert estimate.mean().item() == pytest.approx(light.var().item(), rel=0.1)


def test_atrous_keeps_constants():
    frame = flat(torch.full((1, 3, 13, 17), 3.0))
    image, variance = frame.radiance, torch.rand(1, 1, 13, 17)
    for level in range(5):
        image, variance = atrous(image, variance, surface_of(frame), 2**level, 4.0)
    torch.testing.assert_close(image, frame.radiance)


def test_atrous_spreads_one_pixel_as_the_spline_does_and_variance_by_squared_weights():
    frame = flat(torch.zeros(1, 3, 21, 21))
    frame.radiance[..., 10, 10] = 1.0
    loose, spline = torch.full((1, 1, 21, 21), 1e12), torch.tensor(SPLINE)
    image, variance = atrous(frame.radiance, loose, surface_of(frame), 2, 4.0)
    torch.testing.assert_close(image[0, 0, 6:15:2, 6:15:2], spline[:, None] * spline)
    assert image.count_nonzero() == 3 * 25
    share = spline.square().sum() ** 2
    torch.testing.assert_close(variance[0, 0, 10, 10], 1e12 * share)


@pytest.mark.parametrize("edge", ["depth", "normal", "miss"])
def test_atrous_stops_at_an_edge(edge):
    right = (torch.arange(24) >= 12).expand(1, 1, 24, 24)
    frame = flat(torch.where(right, 5.0, 1.0).expand(1, 3, 24, 24).contiguous())
    tilted = torch.tensor([1.0, 0.0, 0.0]).reshape(1, 3, 1, 1)
    changed = {
        "depth": {"depth": torch.where(right, 5.5, 5.0)},
        "normal": {"normal": torch.where(right, tilted, frame.normal)},
        "miss": {"depth": torch.where(right, 0.0, 5.0), "normal": torch.where(right, 0.0, frame.normal)},
    }[edge]
    loose = torch.full((1, 1, 24, 24), 1e12)
    for spacing in (1, 4, 16):
        image, _ = atrous(frame.radiance, loose, surface_of(replace(frame, **changed)), spacing, 4.0)
        torch.testing.assert_close(image, frame.radiance)
        blurred, _ = atrous(frame.radiance, loose, surface_of(frame), spacing, 4.0)
        assert (blurred - frame.radiance).abs().max() > 0.1 or spacing == 16


def test_atrous_follows_a_slanted_wall():
    frame = flat(torch.rand(1, 3, 32, 32))
    slanted = replace(frame, depth=5 + 0.3 * torch.arange(32).float().expand(1, 1, 32, 32))
    loose = torch.full((1, 1, 32, 32), 1e12)
    image, _ = atrous(frame.radiance, loose, surface_of(slanted), 1, 4.0)
    assert image.var() < 0.5 * frame.radiance.var()


def test_the_prefilter_is_a_normalised_gaussian():
    impulse = torch.zeros(1, 1, 5, 5)
    impulse[..., 2, 2] = 16
    assert gaussian(impulse)[0, 0, 1:4, 1:4].tolist() == [[1, 2, 1], [2, 4, 2], [1, 2, 1]]
    torch.testing.assert_close(gaussian(torch.ones(1, 1, 4, 3)), torch.ones(1, 1, 4, 3))


def test_texture_comes_through_untouched():
    albedo = 0.02 + torch.rand(1, 3, 24, 24)
    albedo[..., :4] = 0  # black, as mirrors are
    radiance = torch.where(albedo > 0, albedo * 3, 0.7)
    frame = replace(flat(radiance), albedo=albedo)
    image, _ = run(Svgf(), [frame] * 3)
    torch.testing.assert_close(image, frame.radiance, rtol=1e-4, atol=1e-6)


def test_history_counts_frames_and_starts_anew_where_something_was_uncovered():
    frames = moving_square(6)
    _, state = run(Svgf(), frames)
    assert uncovered(frames)[-1][HIDDEN].all()
    assert (state.length[HIDDEN] == 1).all()
    assert (state.length[..., 18:, :] == 6).all()  # wall that never was hidden
    _, state = run(Svgf(), [flat(torch.ones(1, 3, 8, 8))] * 40)
    assert (state.length == 32).all()


def test_trmv_takes_background_where_a_traditional_vector_leads_to_the_occluder():
    *before, frame = moving_square(6)
    histories = []
    for method in (Svgf(), Svgf(depth_tolerance=math.inf), Trmv()):
        _, state = run(method, before)
        histories.append(method.reproject(frame, state, frame.radiance / frame.albedo, kind_of(frame)))
    none, occluder, background = histories
    assert (none.length[HIDDEN] == 0).all()
    torch.testing.assert_close(occluder.irradiance[HIDDEN], torch.full((1, 3, 8, 1), SQUARE), rtol=0.01, atol=0)
    torch.testing.assert_close(background.irradiance[HIDDEN], torch.full((1, 3, 8, 1), WALL), rtol=0.01, atol=0)
    assert (background.length[HIDDEN] >= 1).all()


def test_trmv_is_svgf_where_nothing_was_uncovered():
    frames = [flat(torch.rand(1, 3, 16, 16)) for _ in range(3)]
    shared = {"sigma_l": 4.0, "sigma_n": 64.0, "sigma_z": 1.0, "alpha": 0.1}
    assert torch.equal(run(Svgf(**shared), frames)[0], run(Trmv(**shared), frames)[0])


def test_reprojection_interpolates_and_falls_back_to_neighbours():
    ramp = torch.arange(8).float().expand(1, 3, 8, 8)
    frame = flat(ramp)
    _, state = Svgf().step(frame)
    state = replace(state, irradiance=ramp)

    def reproject(frame, state):
        return Svgf().reproject(frame, state, ramp, kind_of(frame))

    half = replace(frame, motion=frame.motion + torch.tensor([0.5, 0.0]).reshape(1, 2, 1, 1))
    torch.testing.assert_close(reproject(half, state).irradiance[..., 3, :7], ramp[..., 3, :7] + 0.5)
    # One bilinear tap fails: the other alone counts. The only one fails: the mean of its eight neighbours.
    depth = state.depth.clone()
    depth[..., 3, 4] = 9.0
    hole = replace(state, depth=depth)
    assert reproject(half, hole).irradiance[0, 0, 3, 3] == 3
    assert reproject(frame, hole).irradiance[0, 0, 3, 4].item() == pytest.approx(4)
    # Nothing fits, or it is off the screen: no history.
    assert reproject(frame, replace(state, depth=state.depth * 2)).length.max() == 0
    assert reproject(replace(frame, motion=frame.motion + 100), state).length.max() == 0


def test_history_is_clamped_on_request():
    frames = [flat(torch.full((1, 3, 12, 12), value)) for value in (9.0, 1.0)]
    _, state = run(Svgf(clamp=1.0), frames)
    torch.testing.assert_close(state.irradiance, torch.full((1, 3, 12, 12), 2.0))
    _, state = run(Svgf(), frames)
    torch.testing.assert_close(state.irradiance, torch.full((1, 3, 12, 12), 10.0))


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_exposure_scales_the_output(scale):
    frames = moving_square(4, noise=1.0)
    expected, _ = run(Trmv(), frames)
    image, _ = run(Trmv(), [replace(f, radiance=f.radiance * scale) for f in frames])
    torch.testing.assert_close(image / scale, expected, rtol=1e-3, atol=1e-5)


def test_bad_pixels_leave_no_trace_in_history():
    frames = moving_square(3, noise=1.0)
    image, state = run(Trmv(), [with_bad_pixels(frames[0]), *frames[1:]])
    for tensor in (image, state.irradiance, state.moments, state.length, state.spread):
        assert tensor.isfinite().all()
    bright = replace(frames[0], radiance=frames[0].radiance * 3e37)
    image, state = run(Svgf(), [bright, bright])
    assert image.isfinite().all() and state.moments.isfinite().all()


def test_a_missing_layer_is_named():
    frame = replace(flat(torch.ones(1, 3, 8, 8)), normal=None, name="shot/frame.0001.exr")
    with pytest.raises(InputError, match=r"frame\.0001\.exr: layer normal is missing"):
        Svgf().step(frame)


def test_history_of_another_size_is_refused():
    _, state = Svgf().step(flat(torch.ones(1, 3, 8, 8)))
    with pytest.raises(InputError, match="history=None"):
        Svgf().step(flat(torch.ones(1, 3, 8, 9)), state)


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (5, 3)])
def test_small_images(size):
    frame = flat(torch.full((1, 3, *size), 2.0))
    image, _ = run(Trmv(clamp=1.0), [frame] * 3)
    torch.testing.assert_close(image, frame.radiance)


def test_a_batch_is_its_frames():
    sequences = [make_frames(3, seed=seed) for seed in (1, 2)]
    together, _ = run(Trmv(), [stack(list(pair)) for pair in zip(*sequences, strict=True)])
    alone = torch.cat([run(Trmv(), frames)[0] for frames in sequences])
    torch.testing.assert_close(together, alone)


def test_both_beat_accumulation_on_the_sample_and_trmv_wins_where_something_was_uncovered():
    frames = list(open_sequence(SAMPLE, signal="indirect", layers=("reference", "reference_half")))
    results = evaluate(frames, ["accumulate", "accumulate-clamped", "svgf", "trmv"])
    accumulate, clamped, svgf, trmv = (result.errors for result in results)
    for region in ("frame", "uncovered"):
        for errors in (svgf, trmv):
            assert errors[region]["psnr"] > accumulate[region]["psnr"] + 2
    assert clamped["uncovered"]["psnr"] > accumulate["uncovered"]["psnr"]
    assert trmv["uncovered"]["psnr"] > svgf["uncovered"]["psnr"]
