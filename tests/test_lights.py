"""`denoise --lights` and `--also`: the light of a Cycles frame in parts, filtered by the kernels of the whole."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from synthetic import Stop, make_frames, stop_after, write_sequence

import rtdenoise
from rtdenoise.cli.main import main
from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.sequences import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.models import load
from rtdenoise.models.parts import ALBEDO, Output, Parts, step
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options
from rtdenoise.sanitise import sanitise

SHOT = Path(__file__).parent / "data" / "cycles"
LOBES = ("Diffuse", "Glossy", "Transmission")
HALF = 2.0**-10  # relative error of a product of two halves


def image(path, name):
    """[3, H, W]; the name "": R,G,B."""
    names = [f"ViewLayer.{name}.{c}" if name else c for c in "RGB"]
    return np.stack(list(read_channels(path, names).values()))


def sum_of_lights(path):
    total = image(path, "Emission") + image(path, "Environment")
    for lobe in LOBES:
        light = image(path, f"{lobe} Direct") + image(path, f"{lobe} Indirect")
        total = total + light * image(path, f"{lobe} Color")
    return total


def assert_same_but_for_limits(a, b):
    """All is linear in the light but two limits: no negative light, and no overshoot of the cubic lookup."""
    apart = np.abs(a - b) / (b + 1e-2)
    assert np.quantile(apart, 0.97) < 2e-3 and apart.max() < 0.06, (np.quantile(apart, 0.97), apart.max())


def run(out, source=SHOT, **options):
    denoise(str(source), out, Options(model="fast", **options))
    return sorted(out.glob("*.exr"))


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return run(tmp_path_factory.mktemp("plain"), lights=True, float32=True)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return run(tmp_path_factory.mktemp("source"), lights=True, float32=True, layout="source")


def relit(folder, *changes, frames=2):
    """The first frames of the shot with channels changed by functions of {name: plane}."""
    folder.mkdir()
    for path in sorted(SHOT.glob("*.exr"))[:frames]:
        planes = read_channels(path, list(read_header(path).channels))
        for change in changes:
            change(planes)
        write_layers(folder / path.name, planes, dtypes=dict.fromkeys(planes, "float"))
    return folder


def test_the_passes_in_the_file_add_up_to_combined(source):
    for path in source:
        combined = image(path, "Combined")
        np.testing.assert_allclose(sum_of_lights(path), combined, rtol=HALF, atol=1e-4)


def test_both_layouts_hold_the_same_picture(plain, source):
    for a, b in zip(plain, source, strict=True):
        assert_same_but_for_limits(image(a, ""), image(b, "Combined"))


def test_the_noise_goes_and_the_brightness_stays(plain):
    for path, clean in list(zip(sorted(SHOT.glob("*.exr")), plain, strict=True))[1:]:
        noisy, clean = image(path, "Combined"), image(clean, "")
        assert np.abs(np.diff(clean, axis=2)).mean() < 0.5 * np.abs(np.diff(noisy, axis=2)).mean()
        assert clean.mean() == pytest.approx(noisy.mean(), rel=0.1)


def test_every_pass_is_denoised_and_all_else_stays(source):
    changed = {f"{lobe} {kind}" for lobe in LOBES for kind in ("Direct", "Indirect", "Color")}
    changed |= {"Combined", "Emission", "Environment"}
    before = sorted(SHOT.glob("*.exr"))[2]
    a, b = read_header(before), read_header(source[2])
    assert [p.name for p in a.parts] == [p.name for p in b.parts]
    others = [name for name in a.channels if name.split(".")[1] not in changed or name.endswith("Combined.A")]
    x, y = read_channels(before, others), read_channels(source[2], others)
    assert others and all(np.array_equal(x[name], y[name]) for name in others)
    for name in ("Diffuse Direct", "Diffuse Indirect", "Glossy Indirect"):
        assert not np.array_equal(image(before, name), image(source[2], name)), name


def test_alpha_stays_as_rendered(plain):
    for path, clean in zip(sorted(SHOT.glob("*.exr")), plain, strict=True):
        (alpha,) = read_channels(path, ["ViewLayer.Combined.A"]).values()
        assert np.array_equal(read_channels(clean, ["A"])["A"], alpha)


def groups(planes):
    """Two light groups, which add up to the picture."""
    for c in "RGB":
        x = planes[f"ViewLayer.Combined.{c}"]
        share = np.indices(x.shape).sum(0) % 5 / 4
        planes[f"ViewLayer.Combined_key.{c}"], planes[f"ViewLayer.Combined_fill.{c}"] = share * x, (1 - share) * x


def test_layers_that_add_up_to_the_picture_still_do(tmp_path):
    """Two light groups: the kernels of the whole filter them, so the whole is their sum."""
    shot = relit(tmp_path / "shot", groups, frames=3)
    clean = run(tmp_path / "out", shot, also=("Combined_key", "Combined_fill"), float32=True)
    alone = run(tmp_path / "alone", shot, float32=True)
    for path, other in zip(clean, alone, strict=True):
        parts = [np.stack([read_channels(path, [f"{n}.{c}"])[f"{n}.{c}"] for c in "RGB"])
                 for n in ("Combined_key", "Combined_fill")]  # fmt: skip
        np.testing.assert_allclose(image(path, ""), image(other, ""), rtol=1e-5, atol=1e-6)
        assert_same_but_for_limits(sum(parts), image(path, ""))
        assert all(part.max() > 0.1 for part in parts)
    both = run(tmp_path / "both", shot, also=("Combined_key",), lights=True, layout="source", float32=True)
    key = [f"Combined_key.{c}" for c in "RGB"]
    for path, other in zip(both, clean, strict=True):
        np.testing.assert_allclose(image(path, "Combined_key"), list(read_channels(other, key).values()), rtol=1e-5,
                                   atol=1e-6)  # fmt: skip


@pytest.mark.parametrize("layout", ["plain", "source"])
def test_light_groups_add_up_to_the_sum_of_the_passes(tmp_path, layout):
    shot, also = relit(tmp_path / "shot", groups), ("Combined_key", "Combined_fill")
    prefix, picture = ("ViewLayer.", "Combined") if layout == "source" else ("", "")
    for path in run(tmp_path / "out", shot, lights=True, also=also, layout=layout, float32=True):
        key, fill = (
            np.stack(list(read_channels(path, [f"{prefix}{name}.{c}" for c in "RGB"]).values())) for name in also
        )
        np.testing.assert_allclose(key + fill, image(path, picture), rtol=1e-5, atol=1e-6)
        assert key.max() > 0.1 and fill.max() > 0.1


def test_layers_of_any_name_leave_the_picture_as_it_is(tmp_path):
    """`color` and `motion` are layers of ours, with other channels."""
    names = ("color", "motion", "A")

    def named(planes):
        for name in names:
            planes |= {f"ViewLayer.{name}.{c}": 0.1 * planes[f"ViewLayer.Combined.{c}"] for c in "RGB"}

    (path,) = run(tmp_path / "out", relit(tmp_path / "shot", named, frames=1), also=names, float32=True)
    (alone,) = run(tmp_path / "alone", relit(tmp_path / "same", frames=1), float32=True)
    np.testing.assert_allclose(image(path, ""), image(alone, ""), rtol=1e-5, atol=1e-6)
    assert {f"{name}.{c}" for name in names for c in "RGB"} <= set(read_header(path).channels)


def test_the_whole_as_its_only_part_is_the_whole():
    """Kernels, albedo, running means and history are those of `step`."""
    network, history, other = load("fast"), None, None
    for frame in make_frames(3):
        frame = sanitise(frame)
        parts = Parts(frame.radiance, frame.radiance[:, :0], (ALBEDO,), (Output(lights=(0,)),))
        with torch.inference_mode():
            image, outputs, history = step(network, frame, parts, history)
            expected, other = network.step(frame, other)
        assert torch.equal(image, expected)
        torch.testing.assert_close(outputs, expected, rtol=1e-4, atol=1e-5)


def test_an_interrupted_run_goes_on_to_the_same_end(tmp_path, plain):
    options = Options(model="fast", lights=True, float32=True)
    with pytest.raises(Stop):
        denoise(str(SHOT), tmp_path, options, on_frame=stop_after(2))
    assert denoise(str(SHOT), tmp_path, options).skipped == 2
    for path, other in zip(sorted(tmp_path.glob("*.exr")), plain, strict=True):
        assert np.array_equal(image(path, ""), image(other, ""))


def without(*passes):
    def change(planes):
        for name in [name for name in planes if name.split(".")[1] in passes]:
            del planes[name]

    return change


def dark(planes):
    for c in "RGB":
        planes[f"ViewLayer.Diffuse Direct.{c}"] *= 0


def signed(planes):
    """A layer of colours of which a third is negative."""
    planes |= {f"ViewLayer.bend.{c}": planes[f"ViewLayer.Combined.{c}"] for c in "GB"}
    planes["ViewLayer.bend.R"] = -planes["ViewLayer.Combined.R"]


def mask(planes):
    planes["ViewLayer.mask.X"] = planes["ViewLayer.Combined.R"]


def clear(planes):
    """Volume passes, for there are no volumes."""
    for c in "RGB":
        planes[f"ViewLayer.Volume Direct.{c}"] = 0 * planes[f"ViewLayer.Combined.{c}"]


@pytest.mark.parametrize(("change", "options", "words"), [
    (without("Glossy Color", "Emission"), {"lights": True}, "missing: Glossy Color, Emission; switch on View Layer"),
    (dark, {"lights": True},
     "too much; are there volumes? switch on View Layer > Passes > Light > Volume, or leave --lights out"),
    (lambda planes: (dark(planes), clear(planes)), {"lights": True}, "too much; leave --lights out"),
    (without(), {"also": ("Emision",)}, "did you mean 'Emission'?"),
    (mask, {"also": ("mask",)}, "no layer 'mask' of three colours; the file has Combined, Denoising Albedo, "),
    (without(), {"lights": True, "also": ("Emission",)}, "--also Emission: --lights denoises this pass already"),
    (without(), {"also": ("Vector",)}, "--also Vector: holds vectors (X, Y, Z) and no light: leave it out"),
    (signed, {"also": ("bend",)}, "--also bend: 36 % of it is negative, and light never is"),
    (without(), {"also": ("Combined",)}, "--also Combined: is the picture itself, which is denoised anyway"),
    (without(), {"lights": True, "signal": "indirect"}, "goes with --signal color"),
    (without(), {"lights": True, "keep": ("all",)}, "goes without --keep"),
    (without(), {"lights": True, "offline": True}, "go without --offline"),
    (without(), {"lights": True, "model": "paper"}, "go with --model default, many or fast"),
    (without(), {"lights": True, "backend": "glsl"}, "goes with --backend torch"),
])  # fmt: skip
def test_bad_input_is_one_sentence(tmp_path, change, options, words):
    shot = relit(tmp_path / "shot", change, frames=1)
    with pytest.raises(InputError) as raised:
        denoise(str(shot), tmp_path / "out", Options(**{"model": "fast", **options}))
    assert words.replace("go with", "goes with") in str(raised.value).replace("go with", "goes with")
    assert not list((tmp_path / "out").glob("*.exr"))


@pytest.mark.parametrize("name", ["", "*", "?ndirect", "indirect|albedo", "a\nb"])
def test_a_name_that_is_no_layer_is_one_line(tmp_path, name, capsys):
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    with pytest.raises(SystemExit, match="2"):
        main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast", "--also", name])
    error = capsys.readouterr().err
    assert f"--also: no layer {name!r} of three colours" in error and error.count("\n") == 1


def test_other_renderers_have_no_such_passes(tmp_path):
    shot = write_sequence(tmp_path / "shot", make_frames(1))
    with pytest.raises(InputError, match="light passes of Blender's Cycles"):
        denoise(str(shot), tmp_path / "out", Options(model="fast", lights=True))


def test_an_environment_and_an_emission_are_passed(tmp_path):
    """An even sky behind everything, and a lamp: light without noise comes out as it went in."""

    def add(planes):
        for c, sky in zip("RGB", (0.2, 0.3, 0.5), strict=True):
            planes[f"ViewLayer.Environment.{c}"] += sky
            planes[f"ViewLayer.Combined.{c}"] += sky

    options = {"lights": True, "layout": "source", "float32": True}
    before = run(tmp_path / "before", relit(tmp_path / "dark", frames=3), **options)
    after = run(tmp_path / "after", relit(tmp_path / "light", add, frames=3), **options)
    for a, b in zip(before, after, strict=True):
        sky = image(b, "Environment") - image(a, "Environment")
        np.testing.assert_allclose(sky, np.broadcast_to([[[0.2]], [[0.3]], [[0.5]]], sky.shape), rtol=1e-3)


@pytest.mark.parametrize("first", [0.0, 0.5], ids=["comes into view later", "from the first frame on"])
def test_a_background_that_is_not_in_the_picture_stays_out_of_it(tmp_path, first):
    """With a transparent film Cycles writes the sky into Environment alone."""
    skies = iter((first, 0.5, 0.5))

    def add(planes):
        sky = next(skies)
        for c in "RGB":
            planes[f"ViewLayer.Environment.{c}"] += sky

    before = relit(tmp_path / "shot", add, frames=3)
    options = {"lights": True, "float32": True}
    alone = run(tmp_path / "alone", relit(tmp_path / "dark", frames=3), **options)
    plain = run(tmp_path / "plain", before, **options)
    source = run(tmp_path / "source", before, layout="source", **options)
    for noisy, a, b, c in zip(sorted(before.glob("*.exr")), alone, plain, source, strict=True):
        assert_same_but_for_limits(image(b, ""), image(a, ""))
        assert np.array_equal(image(c, "Environment"), image(noisy, "Environment"))
        np.testing.assert_allclose(sum_of_lights(c) - image(c, "Environment"), image(c, "Combined"), rtol=HALF,
                                   atol=1e-4)  # fmt: skip


def test_broken_pixels_in_a_pass_stay_there(tmp_path):
    def broken(planes):
        planes["ViewLayer.Glossy Direct.R"][5, 5] = np.nan
        planes["ViewLayer.Emission.G"][6, 6] = -np.inf

    for path in run(tmp_path / "out", relit(tmp_path / "shot", broken), lights=True):
        assert np.isfinite(image(path, "")).all()


def test_the_command(tmp_path, capsys):
    shot = tmp_path / "shot"
    shot.mkdir()
    shutil.copy(SHOT / "frame.0001.exr", shot)
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast", "--also", "Emission"])
    assert "1 frames written" in capsys.readouterr().out
    assert {"R", "G", "B", "A", "Emission.R"} <= read_header(tmp_path / "out" / "frame.0001.exr").channels.keys()
    assert rtdenoise.open_sequence(tmp_path / "out", signal="color")[0].size == open_sequence(shot)[0].size
