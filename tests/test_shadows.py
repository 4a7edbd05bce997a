"""Shadows on a shadow catcher, which lie in alpha (`run.shadows`)."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import assert_goes_on, make_frames, save_tiny, write_sequence

from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.run.combine import combine
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import CombineOptions, Options
from rtdenoise.run.shadows import EVERY, are_shadows, find_shadows

H, W = 48, 64
DEFAULT = Options(model="default", lookahead=0)


def caught(frame, seed=0):
    """The frame with a wall that catches a soft shadow on its right: radiance, noisy alpha and its mean `[H, W]`."""
    square = frame.normal[0, 2].numpy() > 0
    deep = np.clip((np.arange(W) - 24) / 24, 0, 0.8) * np.ones((H, 1))
    noise = np.random.default_rng([seed, frame.number]).random((2, H, W))
    share = np.where(noise[0] < deep, 1 - 0.3 * noise[1], 0)  # a sample sees all of a lamp, or little
    exact = np.where(square, 1, deep * (1 - 0.3 / 2))
    return frame.radiance * torch.from_numpy(square).float(), np.where(square, 1, share), exact


def write_caught(folder, count=4, first=0):
    """A sequence in the native layout whose frames from `first` on show a shadow catcher, before that a wall."""
    frames = make_frames(count, H=H, W=W)
    alphas = {f.number: caught(f)[1] if f.number >= first else np.ones((H, W)) for f in frames}
    shot = write_sequence(folder, [replace(f, radiance=caught(f)[0]) if f.number >= first else f for f in frames])
    for path, alpha in zip(sorted(shot.iterdir()), alphas.values(), strict=True):
        channels = read_header(path).channels
        layers = read_channels(path, list(channels), as_stored=True) | {"A": alpha}
        write_layers(path, layers, dtypes=channels | {"A": "half"})
    return shot


def error(path, exact):
    return np.sqrt(np.square(read_channels(path, ["A"])["A"] - exact).mean())


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    return write_caught(tmp_path_factory.mktemp("caught") / "shot")


@pytest.mark.parametrize("options", [
    DEFAULT, replace(DEFAULT, layout="source"), replace(DEFAULT, lookahead=2), replace(DEFAULT, keep=("depth",)),
    replace(DEFAULT, also=("indirect",)), Options(offline=True),
], ids=["plain", "source", "ahead", "keep", "also", "offline"])  # fmt: skip
def test_the_noise_goes_and_the_picture_stays(shot, tmp_path, options):
    summary = denoise(str(shot), tmp_path / "clean", options)
    told = [note for note in summary.notes if "shadow catcher" in note]
    assert told == ["alpha: shadows on a shadow catcher, denoised as light by default"]
    denoise(str(shot), tmp_path / "rendered", replace(options, alpha="rendered"))
    frame = make_frames(4, H=H, W=W)[3]
    clean, rendered = (tmp_path / name / "frame.0003.exr" for name in ("clean", "rendered"))
    assert read_header(clean).channels == read_header(rendered).channels and read_header(clean).channels["A"] == "half"
    exact = caught(frame)[2]
    assert error(clean, exact) < 0.35 * error(rendered, exact)
    for mine, other in zip(*(read_channels(p, "RGB").values() for p in (clean, rendered)), strict=True):
        assert np.array_equal(mine, other)


def test_an_interrupted_run_goes_on_to_the_same_end(shot, tmp_path):
    assert_goes_on(shot, tmp_path, DEFAULT, 2)


def test_a_run_goes_on_where_frames_with_a_catcher_are_appended(tmp_path):
    shot, parts = write_caught(tmp_path / "shot", EVERY + 1, first=EVERY), tmp_path / "parts"
    parts.mkdir()
    frames = sorted(shot.iterdir())
    for count in (3, len(frames)):
        for path in frames[:count]:
            shutil.copy2(path, parts)
        summary = denoise(str(parts), tmp_path / "appended", DEFAULT)
    assert summary.skipped == 3
    denoise(str(shot), tmp_path / "whole", DEFAULT)
    for path in frames:
        assert (tmp_path / "whole" / path.name).read_bytes() == (tmp_path / "appended" / path.name).read_bytes()


def test_a_catcher_that_comes_later_is_found(tmp_path):
    shot = write_caught(tmp_path / "shot", EVERY + 1, first=EVERY)
    assert find_shadows(open_sequence(shot), DEFAULT) == "A"
    assert not find_shadows(open_sequence(shot / "frame.000*.exr"), DEFAULT)
    assert not find_shadows(open_sequence(shot, signal="indirect"), DEFAULT)


@pytest.mark.parametrize("alpha", ["auto", "rendered"])
def test_combine_takes_alpha_from_the_denoised_frames(shot, tmp_path, alpha):
    denoise(str(shot), tmp_path / "clean", DEFAULT)
    options = CombineOptions(model="shrinkage", alpha=alpha)
    combine(str(shot), str(tmp_path / "clean"), tmp_path / "out", options)
    wanted = (tmp_path / "clean" if alpha == "auto" else shot) / "frame.0003.exr"
    assert np.array_equal(*(read_channels(p, ["A"])["A"] for p in (tmp_path / "out" / wanted.name, wanted)))


@pytest.mark.parametrize("choose", [
    lambda folder: (Options(model=str(save_tiny(folder))), "tiny"),
    lambda folder: (Options(offline=True, motion_blur=True), "--offline with --motion-blur"),
    lambda folder: (Options(model="default", correct=True, samples=16), "--correct"),
], ids=["tiny", "offline", "correct"])  # fmt: skip
def test_what_cannot_says_so(shot, tmp_path, choose):
    options, why = choose(tmp_path)
    summary = denoise(str(shot), tmp_path / "out", options)
    (told,) = [note for note in summary.notes if "shadow catcher" in note]
    assert "stay as noisy as rendered" in told and why in told
    if options.motion_blur:
        return
    frame = make_frames(4, H=H, W=W)[3]
    assert error(tmp_path / "out" / "frame.0003.exr", caught(frame)[1]) < 1e-3


def test_coverage_holdouts_and_veils_are_no_shadows():
    frame = make_frames(1, H=H, W=W)[0]
    black, alpha, _ = caught(frame)
    assert are_shadows(alpha, replace(frame, radiance=black))
    hit = np.indices((H, W)).sum(0) % 2  # silhouettes everywhere
    assert not are_shadows(alpha, replace(frame, radiance=black, depth=torch.from_numpy(hit)[None, None]))
    assert not are_shadows(np.where(frame.normal[0, 2] > 0, 1, 0), replace(frame, radiance=black))  # a holdout
    assert not are_shadows(alpha, frame)  # a veil, which has light of its own
    assert not are_shadows(np.full((H, W), 0.5), replace(frame, radiance=torch.zeros_like(black)))  # black glass
