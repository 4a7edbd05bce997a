"""A real Cycles sequence (tests/data/cycles): read, judged, denoised, and written back for Blender's compositor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

import rtdenoise
from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, read_header, write_layers, write_like
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.run.inspect import inspect

SHOT = Path(__file__).parent / "data" / "cycles"
HALF = 2.0**-11  # relative error of one rounding to half
LOBES = ("Diffuse", "Glossy", "Transmission")
SHORT = {"Diffuse": "Diff", "Glossy": "Gloss", "Transmission": "Trans", "Direct": "Dir", "Indirect": "Ind",
         "Color": "Col", "Emission": "Emit", "Environment": "Env"}  # fmt: skip


def passes(path, *names):
    """[3, H, W] of each pass."""
    channels = read_channels(path, [f"ViewLayer.{name}.{c}" for name in names for c in "RGB"])
    return [np.stack([channels[f"ViewLayer.{name}.{c}"] for c in "RGB"]) for name in names]


def sum_of_lights(path):
    total = sum(passes(path, "Emission", "Environment"))
    for lobe in LOBES:
        direct, indirect, color = passes(path, f"{lobe} Direct", f"{lobe} Indirect", f"{lobe} Color")
        total = total + (direct + indirect) * color
    return total


def denoise(tmp_path, model, *options, shot=SHOT):
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", model, *options])
    return tmp_path / "out"


# --- reading ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signal", ["color", "indirect"])
def test_the_convention_check_is_right(signal):
    found = inspect(SHOT, signal=signal)
    assert (found.preset, found.files, found.size, found.missing) == ("cycles", 5, (64, 96), {})
    assert found.demodulated == (signal == "indirect")
    assert (found.convention.status, found.convention.feature) == ("ok", "albedo")
    assert found.motion.uncovered > 0.01


# Changes to Vector (X, Y = previous - current, Z, W = current - next, y up), and the words that name it.
WRONG = {
    "negated": (lambda x, y, z, w: (-x, -y, -z, -w), "current - previous: negate it"),
    "y down": (lambda x, y, z, w: (x, -y, z, -w), "y up: flip y"),
    "components swapped": (lambda x, y, z, w: (-y, -x, -w, -z), "swap the components"),
    "fields swapped": (lambda x, y, z, w: (-z, -w, -x, -y), "the content of motion_next: read that layer"),
    "UV": (lambda x, y, z, w: (x / 96, y / 64, z / 96, w / 64), "UV units: multiply by (W, H)"),
    "NDC": (lambda x, y, z, w: (x / 48, y / 32, z / 48, w / 32), "NDC units: multiply by (W/2, H/2)"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_vectors_are_named(tmp_path, name):
    change, words = WRONG[name]
    channels = [f"ViewLayer.Vector.{c}" for c in "XYZW"]
    for path in SHOT.glob("*.exr"):
        vector = read_channels(path, channels).values()
        write_like(tmp_path / path.name, path, dict(zip(channels, change(*vector), strict=True)))
    verdict = inspect(tmp_path).convention
    assert verdict.status == "wrong" and words in verdict.message


def test_the_names_of_blender_3_and_4(tmp_path):
    """One part instead of many, and short names of the light passes."""
    source = SHOT / "frame.0003.exr"
    planes = {}
    for name, plane in read_channels(source, list(read_header(source).channels)).items():
        layer, pass_name, component = name.split(".")
        short = "".join(SHORT.get(word, f" {word}") for word in pass_name.split()).strip()
        planes[f"{layer}.{short}.{component}"] = plane
    assert {"ViewLayer.DiffInd.R", "ViewLayer.TransCol.R", "ViewLayer.Denoising Albedo.R"} <= planes.keys()
    write_layers(tmp_path / "1.exr", planes, dtypes=dict.fromkeys(planes, "float"))
    for signal in ("color", "indirect"):
        old, new = open_sequence(tmp_path, signal=signal)[0], open_sequence(source, signal=signal)[0]
        for (layer, a), (_, b) in zip(old.layers(), new.layers(), strict=True):
            assert torch.equal(a, b), layer


@pytest.mark.parametrize("preset", ["auto", "cycles:ViewLayer"])
def test_a_file_of_several_views_is_told_what_to_do(tmp_path, preset):
    planes = {f"ViewLayer.Combined.{view}.{c}": np.ones((4, 4)) for view in ("left", "right") for c in "RGB"}
    write_layers(tmp_path / "1.exr", planes)
    with pytest.raises(InputError, match=r"several views \(left, right\).* render with Individual.*_L.exr"):
        open_sequence(tmp_path, preset=preset)


def test_a_view_layer_may_be_called_as_a_file_that_describes_a_layout(tmp_path):
    write_layers(tmp_path / "1.exr", {f"fg.toml.Combined.{c}": np.ones((4, 4)) for c in "RGB"})
    assert open_sequence(tmp_path, preset="cycles:fg.toml").rules["radiance"].channels[0] == "fg.toml.Combined.R"


# --- writing ----------------------------------------------------------------------------------------------------------


def test_combined_is_the_sum_of_the_lights():
    for path in SHOT.glob("*.exr"):
        (combined,) = passes(path, "Combined")
        np.testing.assert_allclose(sum_of_lights(path), combined, rtol=4 * HALF, atol=1e-4)


def test_source_layout_replaces_the_signal_and_nothing_else(tmp_path, model):
    out = denoise(tmp_path, model, "--signal", "indirect", "--layout", "source", "--float32")
    denoiser, history = rtdenoise.load(model), None
    for frame, path in zip(open_sequence(SHOT, signal="indirect"), sorted(SHOT.glob("*.exr")), strict=True):
        image, history = denoiser.step(frame, history)
        assert np.array_equal(passes(out / path.name, "Diffuse Indirect")[0], image[0].numpy())
        before, after = read_header(path), read_header(out / path.name)
        assert [p.name for p in after.parts] == [p.name for p in before.parts]
        others = [name for name in before.channels if "Diffuse Indirect" not in name]
        assert all(after.channels[name] == before.channels[name] for name in others)
        a, b = read_channels(path, others), read_channels(out / path.name, others)
        assert all(np.array_equal(a[name], b[name]) for name in others)


def test_recombined_in_source_layout_is_the_sum_of_the_lights(tmp_path, model):
    out = denoise(tmp_path, model, "--signal", "indirect", "--layout", "source", "--recombine", "--float32")
    for path in SHOT.glob("*.exr"):
        (combined,) = passes(out / path.name, "Combined")
        (noisy,) = passes(path, "Combined")  # the values that were rounded to half, before denoising
        assert (np.abs(sum_of_lights(out / path.name) - combined) <= 4 * HALF * noisy + 1e-4).all()


def test_recombined_exactly(tmp_path, model):
    """R,G,B = Combined + (denoised - noisy) · Diffuse Color, never negative."""
    plain = denoise(tmp_path, model, "--signal", "indirect", "--recombine", "--float32", "--preview")
    denoiser, history = rtdenoise.load(model), None
    for frame, path in zip(open_sequence(SHOT, signal="indirect"), sorted(SHOT.glob("*.exr")), strict=True):
        image, history = denoiser.step(frame, history)
        combined, noisy, color = passes(path, "Combined", "Diffuse Indirect", "Diffuse Color")
        expected = ((combined - noisy * color) + image[0].numpy() * color).clip(0)
        assert np.array_equal(np.stack(list(read_channels(plain / path.name, "RGB").values())), expected)


@pytest.mark.parametrize(("options", "says"), [
    ((), True), (("--recombine",), False), (("--layout", "source"), False), (("--signal", "color"), False),
])  # fmt: skip
def test_light_without_colour_is_told(tmp_path, model, capsys, options, says):
    denoise(tmp_path, model, *(() if "--signal" in options else ("--signal", "indirect")), *options)
    assert ("light without the surface's colour" in capsys.readouterr().out) == says


def test_color_goes_to_combined(tmp_path, model):
    out = denoise(tmp_path, model, "--layout", "source", "--preview")
    (noisy,), (clean,) = (passes(folder / "frame.0005.exr", "Combined") for folder in (SHOT, out))
    assert not np.array_equal(noisy, clean) and (out / "preview.png").exists()
    assert read_header(out / "frame.0005.exr").channels == read_header(SHOT / "frame.0005.exr").channels
