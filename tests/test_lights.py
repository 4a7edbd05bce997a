"""`denoise --lights` and `--also`: the light of a Cycles frame in parts, each denoised as a picture."""

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
from rtdenoise.data.light import find_light
from rtdenoise.data.light_output import write_light
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.models import load, noiseless
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options
from rtdenoise.run.torch_backend import TorchBackend
from rtdenoise.sanitise import sanitise

SHOT = Path(__file__).parent / "data" / "cycles"
LOBES = ("Diffuse", "Glossy", "Transmission")
HALF = 2.0**-10  # relative error of a product of two halves


def image(path, name):
    """[3, H, W]; the name "": R,G,B, and with a dot before it a layer of the plain layout."""
    layer = f"{name[1:]}." if name.startswith(".") else f"ViewLayer.{name}." if name else ""
    names = [f"{layer}{c}" for c in "RGB"]
    return np.stack(list(read_channels(path, names).values()))


def sum_of_lights(path):
    total = image(path, "Emission") + image(path, "Environment")
    for lobe in LOBES:
        light = image(path, f"{lobe} Direct") + image(path, f"{lobe} Indirect")
        total = total + light * image(path, f"{lobe} Color")
    return total


def run(out, source=SHOT, **options):
    denoise(str(source), out, Options(model="fast", **options))
    return sorted(out.glob("*.exr"))


def lit(out, source=SHOT, **options):
    return run(out, source, **{"lights": True, "float32": True, "layout": "source"} | options)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return run(tmp_path_factory.mktemp("plain"), float32=True)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return lit(tmp_path_factory.mktemp("source"))


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


def test_light_that_half_floats_do_not_hold_once_its_colour_is_divided_out(tmp_path):
    (path,) = sorted(SHOT.glob("*.exr"))[:1]
    planes = read_channels(path, list(read_header(path).channels))
    write_layers(tmp_path / path.name, planes, dtypes=dict.fromkeys(planes, "half"))
    sequence = open_sequence(tmp_path)
    passes, (height, width) = find_light(sequence, True, ()), sequence.size
    parts = {name: np.zeros((1, 3, height, width), np.float32) for name in passes.rules}
    picture = parts["Glossy Direct"] = np.full((1, 3, height, width), 2000, np.float32)  # of a black lobe
    (tmp_path / "out").mkdir()
    write_light(tmp_path / "out", sequence, 0, passes, picture, parts, layout="source")
    np.testing.assert_allclose(sum_of_lights(tmp_path / "out" / path.name), picture[0], rtol=HALF)


def test_the_picture_is_between_that_without_lights_and_the_sum_of_the_lights(plain, source, tmp_path, monkeypatch):
    """But where emission, which passes, is part of it."""
    monkeypatch.setattr("rtdenoise.ops.mix.mix", lambda whole, total, *_, **__: total)
    for of_whole, mixed, of_sum in zip(plain, source, lit(tmp_path), strict=True):
        whole, picture, total = image(of_whole, ""), image(mixed, "Combined"), image(of_sum, "Combined")
        dark = image(mixed, "Emission") == 0
        low, high = np.minimum(whole, total)[dark], np.maximum(whole, total)[dark]
        assert (picture[dark] > low - 1e-4).all() and (picture[dark] < high + 1e-4).all()
        apart = [np.abs(picture - other).mean() for other in (whole, total)]
        assert 0.2 < apart[0] / sum(apart) < 0.8


def test_diffuse_and_glossy_light_have_the_colour_of_their_lobe(tmp_path, monkeypatch):
    """In the frames ahead, too. Transmitted light has the frame's."""
    denoise_, seen = TorchBackend.denoise, []

    def spy(self, frame, history, ahead=()):
        seen.append((frame, ahead))
        return denoise_(self, frame, history, ahead)

    monkeypatch.setattr(TorchBackend, "denoise", spy)
    lit(tmp_path, lookahead=1)

    def layer(frame):
        albedo, path = frame.albedo[0].numpy(), SHOT / Path(frame.name).name
        names = [*(f"{lobe} Color" for lobe in LOBES), "Denoising Albedo"]
        (name,) = [name for name in names if np.array_equal(albedo, image(path, name))]
        return name

    shown = [{layer(f) for f in (frame, *ahead)} for frame, ahead in seen]
    assert all(len(names) == 1 for names in shown) and any(ahead for _, ahead in seen)
    assert set.union(*shown) - {"Denoising Albedo"} == {"Diffuse Color", "Glossy Color"}


def test_light_that_is_missing_in_a_later_frame_is_not_lost(tmp_path):
    """As in fog that begins in mid-shot, where its passes are switched off."""
    brighter = relit(tmp_path / "shot", frames=3)
    path = sorted(brighter.glob("*.exr"))[2]
    planes = read_channels(path, list(read_header(path).channels))
    for c in "RGB":
        planes[f"ViewLayer.Combined.{c}"] = 1.5 * planes[f"ViewLayer.Combined.{c}"]
    write_layers(path, planes, dtypes=dict.fromkeys(planes, "float"))
    with_lights = lit(tmp_path / "lights", brighter)[2]
    without = run(tmp_path / "plain", brighter, float32=True)[2]
    dark = image(with_lights, "Emission") == 0
    np.testing.assert_allclose(image(with_lights, "Combined")[dark], image(without, "")[dark], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["Combined", "Diffuse Direct", "Diffuse Indirect", "Glossy Indirect"])
def test_the_noise_goes_and_the_brightness_stays(source, name):
    for path, clean in list(zip(sorted(SHOT.glob("*.exr")), source, strict=True))[1:]:
        color = 1 if name == "Combined" else image(path, f"{name.split()[0]} Color")
        noisy, clean = color * image(path, name), color * image(clean, name)
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


def test_alpha_stays_as_rendered(source, tmp_path):
    beside = run(tmp_path, also=("Emission",))
    for path, clean, other in zip(sorted(SHOT.glob("*.exr")), source, beside, strict=True):
        (alpha,) = read_channels(path, ["ViewLayer.Combined.A"]).values()
        assert np.array_equal(*read_channels(clean, ["ViewLayer.Combined.A"]).values(), alpha)
        assert np.array_equal(read_channels(other, ["A"])["A"], alpha)


def groups(planes):
    """Two light groups, which add up to the picture."""
    for c in "RGB":
        x = planes[f"ViewLayer.Combined.{c}"]
        share = np.indices(x.shape).sum(0) % 5 / 4
        planes[f"ViewLayer.Combined_key.{c}"], planes[f"ViewLayer.Combined_fill.{c}"] = share * x, (1 - share) * x


@pytest.mark.parametrize("lights", [False, True])
def test_light_groups_add_up_to_the_picture(tmp_path, plain, source, lights):
    shot, also = relit(tmp_path / "shot", groups, frames=3), ("Combined_key", "Combined_fill")
    clean = (lit if lights else run)(tmp_path / "out", shot, also=also, float32=True)
    name = "Combined" if lights else ""
    for path, other in zip(clean, (source if lights else plain)[:3], strict=True):
        key, fill = (image(path, layer if lights else f".{layer}") for layer in also)
        picture = image(path, name)
        np.testing.assert_allclose(key + fill, picture, rtol=1e-5, atol=1e-6)
        assert np.abs(picture - image(other, name)).mean() < 1e-3 * picture.mean()
        assert key.max() > 0.1 and fill.max() > 0.1


def test_a_group_without_the_others_is_a_picture_of_its_own(tmp_path):
    """As if it were the whole."""
    def alone(planes):
        groups(planes)
        for c in "RGB":
            planes[f"ViewLayer.Combined.{c}"] = planes[f"ViewLayer.Combined_key.{c}"]

    beside = run(tmp_path / "out", relit(tmp_path / "shot", groups, frames=3), also=("Combined_key",), float32=True)
    whole = run(tmp_path / "whole", relit(tmp_path / "alone", alone, frames=3), float32=True)
    for path, other in zip(beside, whole, strict=True):
        np.testing.assert_allclose(image(path, ".Combined_key"), image(other, ""), rtol=1e-5, atol=1e-6)


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


@pytest.mark.parametrize("name", ["fast", "hybrid"])
def test_layers_without_noise_leave_the_picture_as_it_is(name):
    """And one colour stays that colour, while ragged edges become smooth."""
    torch.manual_seed(0)
    network, history, other = load(name, precision="fp32"), None, None
    ragged = []
    for frame in make_frames(4):
        frame, (H, W) = sanitise(frame), frame.size
        edges = (torch.arange(W) + 4 * torch.rand(1, 1, H, 1) > W / 2).float().expand(1, 3, H, W)
        with torch.inference_mode():
            image, layers, history = noiseless.step(network, frame, torch.cat([edges, 0 * edges + 0.7], 1), history)
            expected, other = network.step(frame, other)
        assert torch.equal(image, expected)
        torch.testing.assert_close(layers[:, 3:], torch.full_like(image, 0.7))
        ragged.append([(x[..., 1:, :] - x[..., :-1, :]).abs().mean() for x in (edges, layers[:, :3])])
    assert ragged[-1][1] < 0.7 * ragged[-1][0]


def later_lit(planes, first):
    """Transmission from the third frame on, beside what is there."""
    for c in "RGB":
        light = planes[f"ViewLayer.Combined.{c}"] * (0 if first else 0.5)
        planes[f"ViewLayer.Transmission Indirect.{c}"] = light
        planes[f"ViewLayer.Transmission Color.{c}"] = np.ones_like(light)
        planes[f"ViewLayer.Combined.{c}"] = planes[f"ViewLayer.Combined.{c}"] + light


@pytest.mark.parametrize("model", ["fast", "default"])
def test_an_interrupted_run_goes_on_to_the_same_end(tmp_path, model):
    """Also that of a light which comes later than the others."""
    numbers = iter(range(5))
    shot = relit(tmp_path / "shot", lambda planes: later_lit(planes, next(numbers) < 2), frames=5)
    options = Options(model=model, lights=True, layout="source", float32=True)
    denoise(str(shot), tmp_path / "whole", options)
    with pytest.raises(Stop):
        denoise(str(shot), tmp_path / "out", options, on_frame=stop_after(4))
    assert denoise(str(shot), tmp_path / "out", options).skipped == 4
    for path, other in zip(*(sorted((tmp_path / name).glob("*.exr")) for name in ("out", "whole")), strict=True):
        for name in ("Combined", "Diffuse Direct", "Transmission Indirect", "Transmission Color"):
            assert np.array_equal(image(path, name), image(other, name))
    assert image(path, "Transmission Indirect").max() > 0.1


def test_frames_after_serve_every_light(tmp_path, source):
    ahead = lit(tmp_path / "out", lookahead=1)
    for path, other in zip(ahead, source, strict=True):
        np.testing.assert_allclose(sum_of_lights(path), image(path, "Combined"), rtol=HALF, atol=1e-4)
        for name in ("Combined", "Diffuse Direct", "Glossy Indirect"):
            assert not np.array_equal(image(path, name), image(other, name)) or path == ahead[-1]


def tiled(folder, gains):
    """The first frames, four times beside one another, with their light multiplied by the gains."""
    folder.mkdir()
    for path, gain in zip(sorted(SHOT.glob("*.exr")), gains, strict=False):
        stored = read_channels(path, list(read_header(path).channels))
        planes = {name: np.tile(plane, (2, 2)) for name, plane in stored.items()}
        for name in planes:
            if name.split(".")[1].endswith(("Combined", "Direct", "Indirect", "Emission", "Environment")):
                planes[name] = planes[name] * np.float32(gain)
        write_layers(folder / path.name, planes, dtypes=dict.fromkeys(planes, "float"))
    return folder


def test_each_light_of_a_fade_is_denoised_as_steady_light(tmp_path):
    gains = 0.8 ** np.arange(3)
    steady, fading = tiled(tmp_path / "steady", [1, 1, 1]), tiled(tmp_path / "fading", gains)
    wanted, found = lit(tmp_path / "wanted", steady), lit(tmp_path / "found", fading)
    without = lit(tmp_path / "without", fading, detect_exposure=False)
    for name in ("Combined", "Diffuse Direct", "Diffuse Indirect"):
        errors = [np.abs(image(path, name) / gains[2] - image(wanted[2], name)).mean() / image(wanted[2], name).mean()
                  for path in (found[2], without[2])]  # fmt: skip
        assert errors[0] < 0.6 * errors[1], (name, errors)
    np.testing.assert_allclose(image(found[2], "Emission"), image(without[2], "Emission"), rtol=0.02, atol=1e-4)
    assert np.abs(image(found[2], "Diffuse Color") - image(wanted[2], "Diffuse Color")).mean() < 1e-3


def test_a_light_that_is_nowhere_costs_nothing(tmp_path, monkeypatch):
    seen = []
    inner = TorchBackend.denoise
    monkeypatch.setattr(TorchBackend, "denoise", lambda self, *args: seen.append(1) or inner(self, *args))
    dark = ("Glossy Direct", "Glossy Indirect", "Transmission Direct", "Transmission Indirect")

    def without_gloss(planes):
        for c in "RGB":
            for name in dark:
                light, color = planes[f"ViewLayer.{name}.{c}"], planes[f"ViewLayer.{name.split()[0]} Color.{c}"]
                planes[f"ViewLayer.Combined.{c}"] = planes[f"ViewLayer.Combined.{c}"] - light * color
                planes[f"ViewLayer.{name}.{c}"] = 0 * light

    lit(tmp_path / "out", relit(tmp_path / "shot", without_gloss, frames=2))
    assert len(seen) == 2 * 2  # diffuse light, direct and indirect


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


@pytest.fixture(scope="module")
def offline(tmp_path_factory):
    """The offline mode's picture, and with all lights."""
    shot = relit(tmp_path_factory.mktemp("offline") / "shot", groups, frames=3)
    plain = run(shot.parent / "plain", shot, offline=True, float32=True)
    return shot, plain, lit(shot.parent / "lit", shot, offline=True)


def test_offline_its_picture_takes_the_place_of_the_whole(offline, tmp_path, monkeypatch):
    shot, plain, every = offline
    for path in every:
        np.testing.assert_allclose(sum_of_lights(path), image(path, "Combined"), rtol=HALF, atol=1e-4)
    monkeypatch.setattr("rtdenoise.ops.mix.mix", lambda whole, *_, **__: whole)
    for of_whole, path in zip(plain, lit(tmp_path, shot, offline=True), strict=True):
        dark = image(path, "Emission") == 0
        np.testing.assert_allclose(image(path, "Combined")[dark], image(of_whole, "")[dark], rtol=1e-4, atol=1e-4)


def test_offline_light_groups_add_up_to_its_picture(offline, tmp_path):
    shot, plain, _ = offline
    also = ("Combined_key", "Combined_fill")
    for of_whole, path in zip(plain, run(tmp_path, shot, offline=True, also=also, float32=True), strict=True):
        assert np.array_equal(image(path, ""), image(of_whole, ""))
        key, fill = (image(path, f".{name}") for name in also)
        np.testing.assert_allclose(key + fill, image(path, ""), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("killed", [(0, 2), (4, 6), (7, 8)])
def test_offline_an_interrupted_run_goes_on_to_the_same_result(offline, tmp_path, killed):
    """Killed in either pass over the picture, between them and the light, and in that; then once more, for nothing."""
    shot, _, every = offline
    options = Options(model="fast", lights=True, layout="source", float32=True, offline=True)
    for count in killed:
        with pytest.raises(Stop):
            denoise(str(shot), tmp_path / "out", options, on_frame=stop_after(count))
    counted = []
    summary = denoise(str(shot), tmp_path / "out", options, on_frame=lambda *progress: counted.append(progress))
    assert len(set(summary.notes)) == len(summary.notes)
    assert counted[0] == (min(killed[-1], 6), 9) and counted == sorted(counted) and counted[-1] == (9, 9)
    for path in every:
        names = [name for name in read_header(path).channels if name.startswith("ViewLayer.")]
        a, b = read_channels(path, names), read_channels(tmp_path / "out" / path.name, names)
        assert all(np.array_equal(a[name], b[name], equal_nan=True) for name in names)
    assert {p.name for p in (tmp_path / "out").iterdir() if p.is_dir()} == set()
    assert denoise(str(shot), tmp_path / "out", options).written == 0
    with pytest.raises(InputError, match="offline True, now False"):
        denoise(str(shot), tmp_path / "out", Options(model="fast", lights=True, layout="source", float32=True))


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
    (without(), {"lights": True, "layout": "plain"}, "goes with --layout source, which has a place for every pass"),
    (without(), {"also": ("Emission",), "keep": ("all",), "layout": "plain"}, "goes without --keep"),
    (without(), {"lights": True, "offline": True, "confidence": True}, "goes with --offline, and without --lights"),
    (without(), {"lights": True, "model": "paper"}, "go with --model hybrid, default, many or fast"),
    (without(), {"lights": True, "backend": "glsl"}, "goes with --backend torch"),
    (without(), {"lights": True, "backend": "glsl", "offline": True}, "--offline: goes with --backend torch"),
])  # fmt: skip
def test_bad_input_is_one_sentence(tmp_path, change, options, words):
    shot = relit(tmp_path / "shot", change, frames=1)
    with pytest.raises(InputError) as raised:
        denoise(str(shot), tmp_path / "out", Options(**{"model": "fast", "layout": "source", **options}))
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
        denoise(str(shot), tmp_path / "out", Options(model="fast", lights=True, layout="source"))


def test_an_environment_and_an_emission_are_passed(tmp_path):
    """An even sky behind everything, and a lamp: light without noise comes out as it went in."""

    def add(planes):
        for c, sky in zip("RGB", (0.2, 0.3, 0.5), strict=True):
            planes[f"ViewLayer.Environment.{c}"] += sky
            planes[f"ViewLayer.Combined.{c}"] += sky

    before = lit(tmp_path / "before", relit(tmp_path / "dark", frames=3))
    after = lit(tmp_path / "after", relit(tmp_path / "light", add, frames=3))
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
    alone = lit(tmp_path / "alone", relit(tmp_path / "dark", frames=3))
    for noisy, a, b in zip(sorted(before.glob("*.exr")), alone, lit(tmp_path / "source", before), strict=True):
        np.testing.assert_allclose(image(b, "Combined"), image(a, "Combined"), rtol=1e-5, atol=1e-6)
        assert np.array_equal(image(b, "Environment"), image(noisy, "Environment"))
        np.testing.assert_allclose(sum_of_lights(b) - image(b, "Environment"), image(b, "Combined"), rtol=HALF,
                                   atol=1e-4)  # fmt: skip


def test_broken_pixels_in_a_pass_stay_there(tmp_path):
    def broken(planes):
        planes["ViewLayer.Glossy Direct.R"][5, 5] = np.nan
        planes["ViewLayer.Emission.G"][6, 6] = -np.inf

    for path in lit(tmp_path / "out", relit(tmp_path / "shot", broken)):
        assert all(np.isfinite(image(path, name)).all() for name in ("Combined", "Glossy Direct", "Emission"))


def test_the_command(tmp_path, capsys):
    shot = tmp_path / "shot"
    shot.mkdir()
    shutil.copy(SHOT / "frame.0001.exr", shot)
    main(["denoise", str(shot), "--out", str(tmp_path / "out"), "--model", "fast", "--also", "Emission"])
    assert "1 frame written" in capsys.readouterr().out
    assert {"R", "G", "B", "A", "Emission.R"} <= read_header(tmp_path / "out" / "frame.0001.exr").channels.keys()
    assert rtdenoise.open_sequence(tmp_path / "out", signal="color")[0].size == open_sequence(shot)[0].size
