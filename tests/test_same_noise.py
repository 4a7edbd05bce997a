"""Frames with the same noise, of a renderer whose seed stands still (`run.same_noise`)."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from synthetic import write_sequence
from test_lens import OPTIONS, shot

from rtdenoise.run.denoise import denoise
from rtdenoise.run.inspect import inspect
from rtdenoise.run.inspect_text import next_step, render_text
from rtdenoise.run.same_noise import has_same_noise

SAME = "the noise is the same in every frame"


def lit(frames, seeds, samples=1):
    """Textured walls under light of so many samples a pixel, with noise of these seeds."""
    made = []
    for frame, seed in zip(frames, seeds, strict=True):
        g = torch.Generator().manual_seed(seed)
        light = -torch.rand(samples, *frame.radiance.shape[2:], generator=g).log().mean(0)
        made.append(replace(frame, radiance=frame.albedo * light))
    return made


def arrays(frames):
    return [frame.map(torch.Tensor.numpy) for frame in frames]


@pytest.mark.parametrize("samples", [1, 16])
@pytest.mark.parametrize("pan", [(0.0, 0.0), (1.5, -0.6)], ids=["still", "pan"])
def test_a_seed_that_stands_still_is_found(pan, samples):
    assert has_same_noise(*arrays(lit(shot(2, pan=pan), (5, 5), samples)))
    assert not has_same_noise(*arrays(lit(shot(2, pan=pan), (5, 6), samples)))


def test_what_has_no_noise_tells_nothing():
    even = [replace(frame, radiance=torch.full_like(frame.radiance, 0.3)) for frame in shot(2)]
    assert not has_same_noise(*arrays(even)) and not has_same_noise(*arrays(shot(2, pan=(1.5, -0.6))))
    black = [replace(frame, radiance=0 * frame.radiance) for frame in shot(2, pan=(2.0, 0.0))]
    assert not has_same_noise(*arrays(black))


def test_broken_pixels_and_missing_layers():
    one, other = lit(shot(2), (5, 5))
    broken = one.radiance.clone()
    broken[..., :20, :] = torch.nan
    one, other = arrays([replace(one, radiance=broken), replace(other, depth=None, motion=None, motion_next=None)])
    assert has_same_noise(one, other)
    tiny = [replace(f, **{name: layer[..., :2, :2] for name, layer in f.layers()}) for f in (one, other)]
    assert not has_same_noise(*tiny)


def test_sky_without_noise_tells_nothing():
    """It is the same to the bit, as it should be."""
    frames = [replace(frame, depth=0 * frame.depth) for frame in lit(shot(2), (5, 5))]
    assert not has_same_noise(*arrays(frames))


def test_inspect_and_denoise_tell(tmp_path):
    fixed, new = (write_sequence(tmp_path / name, lit(shot(5, pan=(1.0, 0.0)), seeds))
                  for name, seeds in (("fixed", [7] * 5), ("new", range(5))))  # fmt: skip
    found = inspect(fixed)
    assert found.same_noise == (1, 2, 3, 4) and "another seed in every frame" in next_step(found)
    assert "noise        is the same in frames 1, 2, 3, 4, so that history cannot average it" in render_text(found)
    for options in (OPTIONS, replace(OPTIONS, offline=True)):
        notes = denoise(str(fixed), tmp_path / f"fixed {options.offline}", options).notes
        assert sum(note.startswith(SAME) for note in notes) == 1
        assert not any(SAME in note for note in denoise(str(new), tmp_path / f"new {options.offline}", options).notes)
    assert not inspect(new).same_noise and "seed" not in render_text(inspect(new))


def test_twice_the_same_frame_is_no_seed(tmp_path):
    """Animation on twos: every frame is shown twice."""
    frames = [replace(frame, number=i) for i, frame in enumerate(f for f in lit(shot(3), range(3)) for _ in (0, 1))]
    twos = write_sequence(tmp_path / "twos", frames)
    assert not any(SAME in note for note in denoise(str(twos), tmp_path / "out", OPTIONS).notes)
    assert inspect(twos).same_noise == (1, 3, 5) and next_step(inspect(twos)).startswith("rtdenoise denoise")


def test_a_picture_larger_than_what_is_looked_at():
    g = np.random.default_rng(0)
    large = lit(shot(2, size=(600, 640)), (3, 3))
    assert has_same_noise(*arrays(large))
    beside = large[1].radiance.clone()
    beside[..., 40:-40, 60:-60] *= torch.from_numpy(g.uniform(0.5, 1, (520, 520)).astype(np.float32))
    assert not has_same_noise(*arrays([large[0], replace(large[1], radiance=beside)]))
