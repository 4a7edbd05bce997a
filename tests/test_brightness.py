"""Light that changes as a whole: how much is found, and history that goes with it, whatever runs."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from synthetic import Stop, assert_goes_on, make_frames, message, save_tiny, stop_after, write_sequence
from test_denoise import pixels

import rtdenoise
from rtdenoise import models
from rtdenoise.brightness import followed
from rtdenoise.cli.denoise import told
from rtdenoise.data.stored import BRIGHTNESS, read_history, write_history
from rtdenoise.errors import InputError
from rtdenoise.models import AccumulatedKPNConfig
from rtdenoise.run.denoise import STATE, Options, denoise

SIZE = {"H": 64, "W": 112}
FADE = [0.85**i for i in range(6)]
RECENT = AccumulatedKPNConfig(widths=(8, 12, 4, 8, 4), edge_kernel=3, recent=3)


def shot(gains, noise=1.0, seed=0):
    frames = make_frames(len(gains), **SIZE, noise=noise, seed=seed)
    return [replace(frame, radiance=frame.radiance * gain) for frame, gain in zip(frames, gains, strict=True)]


def gains_of(frames):
    found, before = [], None
    for frame in frames:
        found.append(before := followed(frame, before))
    return [brightness.value for brightness in found]


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return save_tiny(tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="module")
def recent(tmp_path_factory):
    torch.manual_seed(0)
    models.save(models.create(RECENT), path := tmp_path_factory.mktemp("recent") / "w.safetensors")
    return path


@pytest.mark.parametrize("seed", range(5))
def test_light_that_stays_has_a_gain_of_exactly_one(seed):
    assert gains_of(shot([1.0] * 6, seed=seed)) == [1.0] * 6


TAILS = {
    "lognormal": lambda shape: (2 * torch.randn(shape)).exp(),
    "Pareto": lambda shape: torch.rand(shape).clamp(min=1e-6).pow(-1 / 1.2),
    "caustics": lambda shape: torch.empty(shape).exponential_() + 400 * (torch.rand(shape) < 1e-3),
    "sparse": lambda shape: 200.0 * (torch.rand(shape) < 5e-3),
}


@pytest.mark.parametrize("tail", TAILS)
def test_skewed_noise_is_no_change(tail):
    """The median ratio of a frame and a mean of several would be one."""
    torch.manual_seed(0)
    like = make_frames(1, H=256, W=320, noise=0.0)[0]
    still = replace(like, motion=torch.zeros_like(like.motion))
    frames = [replace(still, radiance=still.radiance * TAILS[tail]((1, 1, 256, 320))) for _ in range(12)]
    assert gains_of(frames) == [1.0] * 12


@pytest.mark.parametrize(
    "gains",
    [FADE, [1 / gain for gain in FADE], [1.0, 1.0, 2.0, 2.0, 2.0], [1.0, 0.3, 1.3, 0.4, 1.0], [1.0, 1e4, 1e-4, 1.0]],
)
def test_what_all_light_does_is_found(gains):
    np.testing.assert_allclose(gains_of(shot(gains)), gains, rtol=0.08)
    np.testing.assert_allclose(gains_of(shot(gains, noise=0.05)), gains, rtol=0.005)


def test_what_is_less_than_noise_is_found_once_it_has_grown():
    gains = [1.02**i for i in range(24)]
    found = gains_of(shot(gains, noise=0.5))
    assert found[1] == 1.0 and found[-1] > 1.3
    np.testing.assert_allclose(found, gains, rtol=0.12)


@pytest.mark.parametrize("columns", [64, 100, 124])
def test_one_light_of_several_is_not_all_light(columns):
    frames = make_frames(6, H=128, W=224)
    for i, frame in enumerate(frames):
        frame.radiance[..., :columns] *= 0.8**i
    assert gains_of(frames) == [1.0] * 6


def test_a_coloured_light_that_shines_everywhere_is_not_all_light():
    """As a green sign that blinks among red and blue ones: most of the luminance is its."""
    frames = make_frames(6, H=128, W=224)
    for frame in frames[2::2]:
        frame.radiance[:, 1] *= 0.2
    assert gains_of(frames) == [1.0] * 6


def test_light_of_one_colour_dims_as_a_whole():
    gains = [1.0, 0.5, 0.25, 0.5, 1.0]
    frames = shot(gains)
    for frame in frames:
        frame.radiance[:, 1:] = 0
    np.testing.assert_allclose(gains_of(frames), gains, rtol=0.08)


def test_lamps_that_dim_turn_warmer():
    frames = make_frames(6, H=128, W=224)
    for i, frame in enumerate(frames):
        frame.radiance.mul_(torch.tensor([0.93, 0.88, 0.8]).pow(i).reshape(1, 3, 1, 1))
    np.testing.assert_allclose(gains_of(frames), [0.88**i for i in range(6)], rtol=0.08)


def test_a_strobe_beside_light_that_stays_is_not_all_light():
    """Ten times as bright in one corner, and thirty times in the opposite one."""
    frames = make_frames(6, H=128, W=224)
    lamp = torch.linspace(2, 3.6, 224) + torch.linspace(-0.3, 0.3, 128)[:, None]
    for frame in frames[1::2]:
        frame.radiance.mul_(lamp.exp())
    assert gains_of(frames) == [1.0] * 6


def test_a_camera_that_turns_to_the_light_sees_no_change():
    """What is on the screen becomes brighter; no surface does."""
    scene = torch.empty(1, 3, 64, 400).exponential_(generator=torch.Generator().manual_seed(0))
    scene *= torch.linspace(-3, 5, 400).exp()
    like, motion = make_frames(1, **SIZE)[0], torch.tensor([40.0, 0.0]).reshape(1, 2, 1, 1).expand(1, 2, 64, 112)
    flat = replace(like, depth=torch.ones_like(like.depth), normal=torch.zeros_like(like.normal), motion=motion)
    frames = [replace(flat, radiance=scene[..., 40 * i : 40 * i + 112]) for i in range(6)]
    assert frames[-1].radiance.mean() > 10 * frames[0].radiance.mean()
    assert gains_of(frames) == [1.0] * 6


def test_black_frames_are_passed_over():
    gains = [1.0, 1.0, 0.0, 0.0, 1.0, 1.0]
    found = gains_of(shot(gains))
    assert found[:4] == [1.0] * 4
    np.testing.assert_allclose(found[4:], 1.0, rtol=0.08)
    assert gains_of(shot([0.0, 0.0, 1.0, 1.0, 0.5]))[:4] == [1.0] * 4
    assert 0.45 < gains_of(shot([0.0, 0.0, 1.0, 1.0, 0.5]))[4] < 0.55


def test_pictures_of_a_batch_have_gains_of_their_own():
    shots = shot(FADE), shot([1.0] * 6, seed=1)
    together = [replace(a, **{name: torch.cat([x, dict(b.layers())[name]]) for name, x in a.layers()})
                for a, b in zip(*shots, strict=True)]  # fmt: skip
    before = None
    for frame in together:
        before = followed(frame, before)
    assert before.gain.flatten().tolist() == [gains_of(shots[0])[-1], 1.0]


def test_bad_pixels_and_pictures_of_few_blocks_say_nothing():
    frames = shot(FADE)
    clean = gains_of(frames)
    for frame in frames:
        frame.radiance[..., 5, 5], frame.radiance[..., 60, 9], frame.depth[..., 50, 7] = np.nan, np.inf, np.nan
    np.testing.assert_allclose(gains_of(frames), clean, rtol=0.03)
    assert gains_of(make_frames(1) + [replace(f, radiance=f.radiance * 9) for f in make_frames(3)[1:]]) == [1.0] * 3


@pytest.mark.parametrize(
    "options",
    [{}, {"lookahead": 2}, {"lookahead": 3}, {"offline": True}, {"backend": "glsl"}, {"correct": True}],
    ids=lambda options: " ".join(options) or "plain",
)
def test_a_fade_is_denoised_as_steady_light(options, tmp_path, weights, recent):
    model = weights if options.get("backend") else recent
    options = {"plan": False, "float32": True, "precision": "fp32", "model": str(model), **options}
    fade = FADE[:4]
    steady, fading = (write_sequence(tmp_path / name, shot(gains, noise=0.1))
                      for name, gains in (("steady", [1.0] * 4), ("fading", fade)))  # fmt: skip
    denoise(str(steady), tmp_path / "wanted", Options(**options))
    summary = denoise(str(fading), tmp_path / "found", Options(**options))
    denoise(str(fading), tmp_path / "without", Options(**options, detect_exposure=False))
    np.testing.assert_allclose(summary.exposure, fade, rtol=0.02)
    (line,) = (line for line in told(summary, "denoiser") if line.startswith("exposure"))
    assert line.startswith("exposure: all light changes in 3 of 4 frames, by a factor of up to ")
    assert line.endswith(", and history with it")
    most = max(max(a / b, b / a) for a, b in pairwise(fade))
    assert float(line.split("up to ")[1].split(",")[0]) == pytest.approx(most, rel=0.05)
    wanted, found, without = (
        np.stack([pixels(path) for path in sorted((tmp_path / name).glob("*.exr"))])
        for name in ("wanted", "found", "without")
    )
    scale = np.reshape(fade, (-1, 1, 1, 1))
    errors = [np.abs(image / scale - wanted)[1:].mean() / wanted.mean() for image in (found, without)]
    assert errors[0] < 0.01 < errors[1], errors


@pytest.mark.parametrize("lookahead", [0, 2, 3])
def test_a_fade_goes_on_where_it_was_interrupted(lookahead, tmp_path, recent):
    source = write_sequence(tmp_path / "shot", shot([1.3, 1.0, *FADE[1:5]]))
    assert_goes_on(source, tmp_path, Options(model=str(recent), lookahead=lookahead), 3)


def test_both_passes_go_on_where_they_were_interrupted(tmp_path, recent):
    source, options = write_sequence(tmp_path / "shot", shot(FADE[:4])), Options(model=str(recent), offline=True)
    denoise(str(source), tmp_path / "whole", options)
    for count in (2, 6):
        with pytest.raises(Stop):
            denoise(str(source), tmp_path / "parts", options, on_frame=stop_after(count))
    denoise(str(source), tmp_path / "parts", options)
    for path in sorted((tmp_path / "whole").glob("*.exr")):
        assert path.read_bytes() == (tmp_path / "parts" / path.name).read_bytes(), path.name


@pytest.mark.parametrize("lookahead", [0, 2, 3])
def test_a_program_gets_what_denoise_writes(lookahead, tmp_path, recent):
    frames = shot(FADE)
    source = write_sequence(tmp_path / "shot", frames)
    options = Options(model=str(recent), lookahead=lookahead, float32=True, plan=False)
    denoise(str(source), tmp_path / "out", options)
    written = [pixels(path) for path in sorted((tmp_path / "out").glob("*.exr"))]
    denoiser = rtdenoise.Denoiser(recent, lookahead=lookahead)
    layers = ("albedo", "normal", "depth", "motion", "motion_next")
    found = [denoiser(f.radiance, **{name: getattr(f, name) for name in layers}) for f in frames]
    images = [image for image in found if image is not None] + denoiser.flush()
    for image, wanted in zip(images, written, strict=True):
        np.testing.assert_allclose(image[0], wanted, rtol=1e-3, atol=1e-4)  # layers in files are half floats
    without = rtdenoise.Denoiser(recent, detect_exposure=False)
    dark = [without(f.radiance, **{name: getattr(f, name) for name in layers}) for f in frames][-1]
    if not lookahead:
        assert (dark - images[-1]).abs().mean() > 0.05 * images[-1].mean()


def test_a_cut_begins_with_one(tmp_path, weights):
    frames = shot([*FADE[:3], *FADE[:3]], noise=0.1)
    frames = [*frames[:3], *(replace(f, depth=f.depth * 3) for f in frames[3:])]
    summary = denoise(str(write_sequence(tmp_path / "shot", frames)), tmp_path / "out", Options(model=str(weights)))
    assert summary.cuts == [3] and summary.exposure[0] == summary.exposure[3] == 1.0
    np.testing.assert_allclose(summary.exposure, FADE[:3] * 2, rtol=0.02)


def test_steady_light_is_denoised_to_the_bit_as_without(tmp_path, weights):
    source = write_sequence(tmp_path / "shot", shot([1.0] * 4))
    for name, detect in (("with", True), ("without", False)):
        denoise(str(source), tmp_path / name, Options(model=str(weights), detect_exposure=detect))
    for path in sorted((tmp_path / "with").glob("*.exr")):
        assert path.read_bytes() == (tmp_path / "without" / path.name).read_bytes()


def test_a_run_that_began_without_torch_goes_on_with_it(tmp_path, recent, monkeypatch):
    """Its frames have not been followed."""
    source, options = write_sequence(tmp_path / "shot", shot(FADE)), Options(model=str(recent), backend="glsl")
    for count, has_torch in ((2, False), (4, True)):
        monkeypatch.setattr("rtdenoise.run.following.find_spec", lambda name, found=has_torch: found or None)
        with pytest.raises(Stop):
            denoise(str(source), tmp_path / "out", options, on_frame=stop_after(count))
    summary = denoise(str(source), tmp_path / "out", options)
    assert summary.skipped == 4 and summary.exposure[:3] == [1.0] * 3
    np.testing.assert_allclose(summary.exposure[3:], np.array(FADE[3:]) / FADE[2], rtol=0.1)
    with pytest.raises(InputError, match="other options: detect-exposure True, now False"):
        denoise(str(source), tmp_path / "out", replace(options, detect_exposure=False))


@pytest.mark.parametrize("backend", ["torch", "glsl"])
def test_a_shot_with_misses_and_bad_pixels_goes_on(tmp_path, recent, backend):
    frames = shot(FADE)
    for frame in frames:
        frame.depth[..., :9], frame.radiance[..., 40, 40], frame.motion[..., 30, 30] = 3.4e38, 3e38, np.nan
        frame.radiance[..., 20, 20] = np.nan
    source = write_sequence(tmp_path / "shot", frames)
    assert_goes_on(source, tmp_path, Options(model=str(recent), backend=backend), 3)


def test_a_damaged_state_is_told(tmp_path, weights):
    source, options = write_sequence(tmp_path / "shot", shot(FADE)), Options(model=str(weights))
    with pytest.raises(Stop):
        denoise(str(source), tmp_path / "out", options, on_frame=stop_after(3))
    stored, metadata = read_history(tmp_path / "out" / STATE)
    assert stored[BRIGHTNESS].shape == (1, 9, 64, 112)
    write_history(tmp_path / "out" / STATE, stored | {BRIGHTNESS: stored[BRIGHTNESS][..., :-1]}, metadata)
    assert "brightness is (1, 9, 64, 111), expected (1, 9, 64, 112)" in message(
        denoise, str(source), tmp_path / "out", options
    )


def test_of_large_pictures_some_pixels_are_compared():
    frames = [replace(f, **{name: x.repeat(1, 1, 5, 8) for name, x in f.layers()}) for f in shot(FADE, noise=0.1)]
    assert followed(frames[0], None).light.shape[2:] == (160, 448)
    np.testing.assert_allclose(gains_of(frames), FADE, rtol=0.02)
