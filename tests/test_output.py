"""What `denoise` writes for native sequences: recombination, layouts, and what it refuses."""

import numpy as np
import pytest
import torch
from synthetic import TINY, make_frames, write_sequence

from rtdenoise.data.exr import read_channels, write_layers
from rtdenoise.data.output import recombined
from rtdenoise.data.sequences import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.models import TemporalKPN, save
from rtdenoise.run.denoise import Options, denoise

H, W = 5, 7


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("model") / "tiny.safetensors"
    save(TemporalKPN(TINY), path)
    return str(path)


def native(path, color, indirect):
    layers = {"color": color, "indirect": indirect, "albedo": np.full((H, W, 3), 0.25)}
    write_layers(path, layers, dtypes=dict.fromkeys(layers, "float"))
    return open_sequence(path, signal="indirect")


def rgb(path):
    return np.stack(list(read_channels(path, "RGB").values()))


def test_native_indirect_light_contains_the_albedo(tmp_path):
    """beauty = color - indirect_noisy + indirect_denoised"""
    sequence = native(tmp_path / "1.exr", np.full((H, W, 3), 3.0), np.full((H, W, 3), 2.0))
    image = np.full((1, 3, H, W), 0.5, np.float32)
    assert np.array_equal(recombined(sequence, 0, sequence.read(0), image), np.full((1, 3, H, W), 1.5))


def test_direct_light_passes_through(tmp_path):
    """What is not indirect light comes out as it was: to the bit where that is black, within rounding elsewhere."""
    random = np.random.default_rng(0).random
    direct, noisy = random((H, W, 3), np.float32), random((H, W, 3), np.float32) * 4
    noisy[:, : W // 2] = 0
    sequence = native(tmp_path / "1.exr", direct + noisy, noisy)
    image = random((1, 3, H, W), np.float32)
    image[..., : W // 2] = 0
    beauty = recombined(sequence, 0, sequence.read(0), image)
    direct = np.moveaxis(direct, 2, 0)[None]
    assert np.array_equal(beauty[..., : W // 2], direct[..., : W // 2])
    assert np.allclose(beauty, direct + image, rtol=0, atol=5 * 2.0**-22)  # values of up to 5, rounded twice


def test_recombined_is_finite_and_not_negative(tmp_path):
    color, indirect = np.full((H, W, 3), 3.0), np.full((H, W, 3), 2.0)
    color[0, 0], indirect[0, 0] = np.nan, np.nan
    color[0, 1], indirect[0, 1] = np.inf, np.inf
    indirect[0, 2] = 4  # more than the beauty
    sequence = native(tmp_path / "1.exr", color, indirect)
    beauty = recombined(sequence, 0, sequence.read(0), np.full((1, 3, H, W), 0.5, np.float32))
    assert beauty[0, 0, 0, :4].tolist() == [0.5, 0.5, 0, 1.5]


def test_recombining_the_beauty_changes_nothing(tmp_path, model):
    shot = write_sequence(tmp_path / "shot", make_frames())
    for name, recombine in (("a", False), ("b", True)):
        denoise(str(shot), tmp_path / name, Options(model=model, recombine=recombine))
    assert np.array_equal(rgb(tmp_path / "a" / "frame.0003.exr"), rgb(tmp_path / "b" / "frame.0003.exr"))


def test_source_layout_of_native_files(tmp_path, model):
    shot = write_sequence(tmp_path / "shot", make_frames())
    options = Options("indirect", model, layout="source", recombine=True, float32=True)
    denoise(str(shot), tmp_path / "out", options)
    names = [f"indirect.{c}" for c in "RGB"]
    before, after = (read_channels(folder / "frame.0001.exr", names) for folder in (shot, tmp_path / "out"))
    expected = rgb(shot / "frame.0001.exr") + np.stack([after[name] - before[name] for name in names])
    np.testing.assert_allclose(rgb(tmp_path / "out" / "frame.0001.exr"), expected.clip(0), atol=1e-6)


def test_an_interrupted_run_with_another_layout_is_refused(tmp_path, model):
    shot = write_sequence(tmp_path / "shot", make_frames())
    denoise(str(shot), tmp_path / "out", Options(model=model))
    with pytest.raises(InputError, match="other options"):
        denoise(str(shot), tmp_path / "out", Options(model=model, layout="source"))


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"layout": "sauce"}, "unknown layout 'sauce': known are plain, source"),
        ({"layout": "source", "keep": ("albedo",)}, "layout 'source' passes every channel on: leave --keep out"),
        ({"recombine": True, "signal": "indirect"}, "--recombine needs the beauty, the file has "),
    ],
)
def test_what_cannot_be_written_is_refused_before_the_work(tmp_path, model, options, expected):
    shot = tmp_path / "shot"
    shot.mkdir()
    for frame in make_frames(2):
        layers = {layer: tensor[0].permute(1, 2, 0).numpy() for layer, tensor in frame.layers()}
        layers["indirect"] = layers.pop("radiance")
        if "signal" not in options:
            layers["color"] = layers["indirect"]
        write_layers(shot / f"{frame.number}.exr", layers)
    with pytest.raises(InputError) as caught:
        denoise(str(shot), tmp_path / "out", Options(model=model, **options))
    assert expected in str(caught.value) and "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists()
