"""Files that no preset knows: names say which channels are which layer, pictures say what their vectors mean."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import test_inspect
from synthetic import message

from rtdenoise.cli.main import main
from rtdenoise.data.exr import write_layers
from rtdenoise.data.layout import Rule
from rtdenoise.data.layout_file import layout_text, read_layout
from rtdenoise.data.names import guess
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.sequences import convert
from rtdenoise.run.denoise import denoise
from rtdenoise.run.describe import describe, write_description
from rtdenoise.run.inspect import inspect
from rtdenoise.run.inspect_text import next_step
from rtdenoise.run.options import Options

W, H = test_inspect.W, test_inspect.H


def channels(base, pixels, endings="RGB"):
    """`[H, W, C]` as channels by their names."""
    return {f"{base}{c}": np.ascontiguousarray(pixels[..., i], np.float32) for i, c in enumerate(endings)}


def write(folder, layers, kind="moving"):
    """Frames 1001 … as `layers` of one frame makes them: channels, or the channels of each file beneath the folder."""
    for number, frame in enumerate(test_inspect.frames(kind, noise=0.5), 1001):
        made = layers({name: np.asarray(pixels) for name, pixels in frame.items()})
        for name, content in made.items() if isinstance(next(iter(made.values())), dict) else [("shot.{}.exr", made)]:
            path = folder / name.format(number)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_layers(path, content, dtypes=dict.fromkeys(content, "float"))
    return folder


def pictures(frame):
    return channels("", frame["color"]) | channels("albedo.", frame["albedo"])


def arnold(frame):
    """One file for all, vectors to where a pixel comes from, x turned round, and far depths where nothing was hit."""
    depth = frame["depth"][..., 0].copy()
    depth[:5] = 1e30
    return {
        **pictures(frame), **channels("N.", frame["normal"], "XYZ"), "Z": depth,
        **channels("motionvector.", frame["motion"] * [-1, 1], "RG"), "A": np.ones((H, W)),
    }  # fmt: skip


def files(pattern):
    """A file for each layer, fractions of the picture, those of the next frame with y up, normals in [0, 1]."""
    return lambda frame: {
        pattern.format("beauty"): channels("", frame["color"]),
        pattern.format("diffuse_albedo"): channels("", frame["albedo"]),
        pattern.format("Normals"): channels("", 0.5 + 0.5 * frame["normal"]),
        pattern.format("depth"): channels("", frame["depth"].repeat(3, -1)),
        pattern.format("motionBack"): channels("", frame["motion"] / [W, H], "RG"),
        pattern.format("motionFore"): channels("", frame["motion_next"] / [W, -H], "RG"),
    }


def assert_like(sequence):
    """The frames as this project's conventions have them."""
    for frame, made in zip(sequence, test_inspect.frames(noise=0.5), strict=True):
        for layer in ("albedo", "normal", "motion", "motion_next"):
            if (found := getattr(frame, layer)) is not None:
                np.testing.assert_allclose(found[0].permute(1, 2, 0), made[layer], atol=2e-3)


def test_one_file_for_all(tmp_path, capsys):
    shot, preset = write(tmp_path / "shot", arnold), tmp_path / "my.toml"
    told = denoise(shot, tmp_path / "out", Options(model="fast")).notes
    assert any("the files seem to call it otherwise: rtdenoise inspect SEQ --write my.toml" in line for line in told)
    assert next_step(inspect(shot)) == (
        f"rtdenoise inspect {shot} --write my.toml, which describes normal, depth, motion: the files seem to call them "
        "otherwise"
    )
    main(["inspect", str(shot), "--write", str(preset)])
    told = capsys.readouterr().out
    assert told.startswith(f"wrote {preset}\n") and "convention   OK: previous - current, pixels, y down" in told
    assert told.endswith(f"next: rtdenoise denoise {shot} --out clean/ --preset {preset}\n")

    text = preset.read_text()
    assert '[motion]\nchannels = ["motionvector.R", "motionvector.G"]\nsigns = [-1, 1]\n# measured: 9' in text
    assert '[depth]\nchannels = ["Z"]\nmiss = 1e+29\n# 1e+30 is where nothing was hit\n' in text
    sequence = open_sequence(shot, preset=str(preset))
    assert_like(sequence)
    assert (sequence[0].depth[0, 0, :5] == 0).all() and (sequence[0].depth[0, 0, 5:] == 1).all()


@pytest.mark.parametrize("pattern", ["shot_v02_{}.{{}}.exr", "{}/shot_v02.{{}}.exr", "{{}}.{}.EXR"])
def test_a_file_for_each_layer(tmp_path, pattern):
    shot, preset = write(tmp_path / "shot", files(pattern)), tmp_path / "my.toml"
    assert "rtdenoise inspect DIR --write my.toml describes them" in message(open_sequence, shot)
    write_description(shot, preset)
    sequence = open_sequence(shot, preset=str(preset))
    assert len(sequence) == test_inspect.FRAMES and sequence.numbers[0] == 1001
    assert set(sequence.rules) == {"radiance", "albedo", "normal", "depth", "motion", "motion_next"}
    assert_like(sequence)


def test_fields_under_each_others_names(tmp_path):
    def swapped(frame):
        back, forth = channels("backward.", frame["motion_next"], "uv"), channels("forward.", frame["motion"], "uv")
        return {**pictures(frame), **back, **forth}

    layout, _ = describe(write(tmp_path, swapped))
    assert layout.layers["motion"] == (Rule(("forward.u", "forward.v"), (1, 1)),)
    assert layout.layers["motion_next"] == (Rule(("backward.u", "backward.v"), (1, 1)),)


def test_fields_under_each_others_names_in_files(tmp_path):
    def swapped(frame):
        made = files("sh_{}.{{}}.exr")(frame)
        made["sh_motionBack.{}.exr"], made["sh_motionFore.{}.exr"] = (
            made["sh_motionFore.{}.exr"], made["sh_motionBack.{}.exr"],
        )  # fmt: skip
        return made

    shot, preset = write(tmp_path / "shot", swapped), tmp_path / "my.toml"
    write_description(shot, preset)
    assert read_layout(preset).buffers["motion"] == ("sh_motionFore.{frame}.exr",)
    assert read_layout(preset) == replace(describe(shot)[0], name="my")
    sequence = open_sequence(shot, preset=str(preset))
    assert {"motion", "motion_next"} <= set(sequence.rules)
    assert_like(sequence)


ZEROS = {  # the field that is zero everywhere, what the other one holds -> the layer that is described
    "forward": ("backward", "motion", "motion"), "backward": ("forward", "motion_next", "motion_next"),
    "backward, and names are wrong": ("forward", "motion", "motion"),
}  # fmt: skip


@pytest.mark.parametrize("in_files", [False, True])
@pytest.mark.parametrize("name", ZEROS)
def test_a_field_of_zeros_beside_one_that_tells_is_left_out(tmp_path, capsys, name, in_files):
    other, held, layer = ZEROS[name]

    def made(frame):
        zeros, full = (channels("" if in_files else f"{field}.", vectors, "RG") for field, vectors in (
            (name.split(",")[0], 0 * frame["motion"]), (other, frame[held])))  # fmt: skip
        if in_files:
            return {"rgba.{}.exr": pictures(frame), name.split(",")[0] + ".{}.exr": zeros, other + ".{}.exr": full}
        return {**pictures(frame), **zeros, **full}

    shot, preset = write(tmp_path / "shot", made), tmp_path / "my.toml"
    main(["inspect", str(shot), "--write", str(preset)])
    absent = "motion_next" if layer == "motion" else "motion"
    told = "left out: it is (0, 0) everywhere: was motion blur on?"
    assert f"# {absent}: " in preset.read_text() and told in preset.read_text()
    assert told in capsys.readouterr().out
    sequence = open_sequence(shot, preset=str(preset))
    assert layer in sequence.rules and absent not in sequence.rules
    assert_like(sequence)


def test_light_serves_where_albedo_is_missing(tmp_path):
    layout, notes = describe(
        write(tmp_path, lambda f: channels("", f["color"]) | channels("mv.", f["motion"] / [W, H], "RG"))
    )
    assert layout.layers["motion"] == (Rule(("mv.R", "mv.G"), (1, 1), scale="uv"),)
    assert notes["motion"].startswith("measured: ")


def test_the_name_of_a_file_counts_before_that_of_its_folder(tmp_path):
    shot = write(tmp_path, lambda f: {"color/sh.{}.exr": channels("", f["color"]), "color/depth.{}.exr": channels(
        "", f["depth"].repeat(3, -1)), "color/beauty.{}.exr": channels("", f["color"])})  # fmt: skip
    layout, _ = describe(shot)
    assert {layer: files for layer, (files,) in layout.buffers.items()} == {
        "color": "color/beauty.{frame}.exr", "depth": "color/depth.{frame}.exr",
    }  # fmt: skip


STORED = {  # vectors as stored of those of a frame, and the rule that reads them
    "half grey is still": (lambda f: 0.5 + f["motion"] / [W, -H], {"offset": 0.5, "scale": "uv", "signs": (1, -1)}),
    "whole screen": (lambda f: 0.5 + f["motion"] / [2 * W, 2 * H], {"offset": 0.5, "scale": "2uv"}),
    "NDC, y up": (lambda f: -f["motion"] / [W / 2, -H / 2], {"scale": "ndc", "signs": (-1, 1)}),
    "rows, columns": (lambda f: f["motion"][..., ::-1], {"channels": ("velocity.Y", "velocity.X")}),
    "half the shutter": (lambda f: f["motion"] / 2, {"scale": 2.0}),
    "pixels around grey": (lambda f: 0.5 + f["motion"] * [1, -1], {"offset": 0.5, "signs": (1, -1)}),
    "a third": (lambda f: f["motion"] / 3, {"scale": pytest.approx(3, rel=0.05)}),
    "of a greatest movement": (
        lambda f: 0.5 + f["motion"] / 1000, {"offset": 0.5, "scale": pytest.approx(1000, rel=0.05)},
    ),
    "some unknown": (lambda f: np.where(f["depth"] * np.arange(W)[:, None] % 9 < 1, np.nan, f["motion"]), {}),
}


@pytest.mark.parametrize("name", STORED)
def test_what_vectors_mean_is_measured(tmp_path, name):
    stored, expected = STORED[name]
    layout, notes = describe(
        write(tmp_path, lambda f: {**pictures(f), **channels("velocity.", stored(f), "XY")})
    )
    plain = {"channels": ("velocity.X", "velocity.Y"), "signs": (1, 1)}
    assert layout.layers["motion"] == (Rule(**plain | expected),)
    assert notes["motion"].startswith("measured: 9")
    if name in ("some unknown", "a third"):
        return
    path = tmp_path / "my.toml"
    path.write_text(layout_text(layout, notes))
    assert_like(open_sequence(tmp_path, preset=str(path)))


def test_vectors_to_the_next_frame_are_called_so(tmp_path):
    _, notes = describe(
        write(tmp_path, lambda f: {**pictures(f), **channels("mvec.", f["motion_next"], "RG")})
    )
    assert notes["motion"].endswith("they seem to lead to the next frame: render those from the frame before if "
                                    "you can")  # fmt: skip


def test_still_frames_confirm_nothing(tmp_path):
    layout, notes = describe(write(tmp_path, arnold, kind="static"))
    assert layout.layers["motion"] == (Rule(("motionvector.R", "motionvector.G"), (1, 1)),)
    assert notes["motion"] == "not confirmed: it is (0, 0) everywhere: was motion blur on?"


NOTHING = {  # vectors that say nothing, and what is told
    "zeros": (lambda f: 0 * f["motion"], "it is (0, 0) everywhere: was motion blur on?"),
    "directions": (lambda f: f["motion"] / np.linalg.norm(f["motion"], axis=-1, keepdims=True), "directions alone"),
    "clamped": (lambda f: (0.5 - f["motion"] / 3.5).clip(0, 1), "of it ends at 0 or 1: clamped"),
    "of a crop": (lambda f: f["motion"] / [W, -2 * H], "fits, which is no unit"),
    "noise": (lambda f: np.random.default_rng(0).normal(size=(H, W, 2)), ""),
}


@pytest.mark.parametrize("name", NOTHING)
def test_what_cannot_be_read_is_not_confirmed(tmp_path, name):
    stored, told = NOTHING[name]
    _, notes = describe(write(tmp_path, lambda f: {**pictures(f), **channels("velocity.", stored(f), "RG")}))
    assert notes["motion"].startswith("not confirmed: ") and told in notes["motion"]


DEPTHS = {  # of the upper rows, and the lower ones behind 2 … 5 -> rule, and a part of the note
    "mostly endless": ((1e10, 50), {"miss": 1e9}, "1e+10 is where nothing was hit"),
    "greatest half": ((65504.0, 5), {"miss": 64849.0}, "6.55e+04 is where"),
    "a number that may be a wall": ((100.0, 5), {}, "in 7% of the pixels exactly that: if nothing was hit there"),
    "behind the camera": ((-3.0, 5), {"signs": (-1,)}, "from 2.208 to 5"),
}


@pytest.mark.parametrize("name", DEPTHS)
def test_where_nothing_was_hit(tmp_path, name):
    (far, rows), expected, told = DEPTHS[name]
    depth = np.linspace(2, 5, H * W).reshape(H, W)
    depth = -depth if far < 0 else depth
    depth[:rows] = far
    layout, notes = describe(write(tmp_path, lambda f: {**pictures(f), "Z": depth}))
    assert layout.layers["depth"] == (Rule(("Z",), **({"signs": (1,)} | expected)),)
    assert told in notes["depth"]


@pytest.mark.parametrize("rows", [5, 60])  # of 72: few pixels, and most of them
def test_a_miss_may_have_the_other_sign(tmp_path, rows):
    depth = -np.linspace(2, 5, H * W).reshape(H, W)
    depth[:rows] = 1e10
    shot = write(tmp_path / "shot", lambda f: {**pictures(f), "Z": depth})
    layout, notes = describe(shot)
    assert layout.layers["depth"] == (Rule(("Z",), (-1,), miss=1e9),)
    found = inspect(shot, preset=layout)
    assert notes["depth"] == "1e+10 is where nothing was hit" and not found.faults
    frame = open_sequence(shot, preset=layout)[0]
    np.testing.assert_allclose(frame.depth[0, 0], np.where(depth > 0, 0, -depth), rtol=1e-6)


def test_black_normals_that_are_stored_as_colours_are_none():
    stored = {"X": np.float32([[0, 0.5]]), "Y": np.float32([[0, 0]]), "Z": np.float32([[0, 0.5]])}
    rule = Rule(("X", "Y", "Z"), (1, 1, 1), scale=2.0, offset=0.5)
    assert convert(rule, stored, "normal")[0, :, 0].T.tolist() == [[0, 0, 0], [0, -1, 0]]
    assert convert(replace(rule, offset=0.0), stored, "normal")[0, :, 0].T.tolist() == [[0, 0, 0], [1, 0, 1]]


def test_other_files_change_nothing(tmp_path):
    """Files inside a folder with frames, and such as nothing reads."""
    shot = write(tmp_path / "shot", lambda f: {**pictures(f), **channels("N.", f["normal"], "XYZ")})
    before = inspect(shot)
    (shot / "masks").mkdir()
    for number in range(9):
        (shot / "masks" / f"m.{number}.exr").write_text("no picture")
    assert inspect(shot) == before and before.guessed == ("normal",)
    assert set(describe(shot)[0].layers) == {"color", "albedo", "normal"}


def test_names_of_programs_are_left_to_their_presets(tmp_path):
    cycles = Path(__file__).parent / "data" / "cycles"
    assert "--write is for files that no preset knows; these are cycles's" in message(describe, cycles)


@pytest.mark.parametrize("like", ["cycles", "cycles:ViewLayer"])
def test_motion_of_cycles_that_is_mirrored_is_mended_and_all_else_stays(tmp_path, like):
    """As Blender 4.2 writes it behind a fisheye."""
    def mirrored(frame):
        vectors = np.concatenate([frame["motion"] * [-1, -1], frame["motion_next"] * [1, 1]], 2)
        passes = {"Combined": (frame["color"], "RGB"), "Denoising Albedo": (frame["albedo"], "RGB"),
                  "Normal": (frame["normal"], "XYZ"), "Depth": (frame["depth"], "Z"), "Vector": (vectors, "XYZW")}
        return {k: v for name, of in passes.items() for k, v in channels(f"ViewLayer.{name}.", *of).items()}

    shot, preset = write(tmp_path / "shot", mirrored), tmp_path / "my.toml"
    assert next_step(inspect(shot)).endswith("--write my.toml: with these, history comes from wrong places")
    write_description(shot, preset)
    preset.write_text(preset.read_text().replace('like = "cycles"', f'like = "{like}"'))
    as_preset, mended = open_sequence(shot), open_sequence(shot, preset=str(preset))
    motion = {"motion": (-1, -1), "motion_next": (1, 1)}
    for layer, rule in as_preset.rules.items():
        assert mended.rules[layer] == (replace(rule, signs=motion[layer]) if layer in motion else rule)
    others = replace(mended.layout, layers=as_preset.layout.layers)
    assert others == as_preset.layout and inspect(shot, preset=str(preset)).convention.status == "ok"


@pytest.mark.parametrize(("text", "told"), [
    ('like = 3', "like is 3, expected the name of a preset"),
    ('like = "falcor"', "like is 'falcor', expected native, cycles, mitsuba"),
    ('like = "cycles"\n[motion]\nchannels = ["X", "Y"]\nfile = "{frame}.exr"', "does not go with like = 'cycles'"),
])  # fmt: skip
def test_a_preset_that_is_like_none_is_told(tmp_path, text, told):
    (tmp_path / "my.toml").write_text(text)
    assert told in message(open_sequence, Path(__file__).parent / "data" / "cycles", preset=str(tmp_path / "my.toml"))


def test_layers_of_this_project_stay(tmp_path):
    def more(frame):
        vectors = channels("motion.", -frame["motion"], "XY")
        return {**pictures(frame), **channels("reference.", frame["color"]), **vectors}

    layout, _ = describe(write(tmp_path, more))
    assert layout.layers["reference"] == (Rule(("reference.R", "reference.G", "reference.B"), (1, 1, 1)),)
    assert layout.layers["motion"] == (Rule(("motion.X", "motion.Y"), (-1, -1)),)


def test_components_of_a_metropolis_render_stay(tmp_path):
    def parts(frame):
        color = frame["color"]
        return {**pictures(frame), **channels("large.", color / 4), **channels("small.", color * 3 / 4)}

    shot, preset = write(tmp_path / "shot", parts), tmp_path / "my.toml"
    write_description(shot, preset)
    found, native = (open_sequence(shot, preset=p, layers=("components",))[0] for p in (str(preset), "native"))
    assert found.components.shape == (1, 6, H, W) and (found.components == native.components).all()
    assert read_layout(preset).layers == describe(shot)[0].layers


def a_file_each(folder, *names):
    """Four channels in two frames of each name, `{}` for the frame number."""
    for name in names:
        for number in (1, 2):
            (path := folder / name.format(number)).parent.mkdir(parents=True, exist_ok=True)
            write_layers(path, {c: np.ones((4, 4), np.float32) for c in "RGBA"})
    return folder


@pytest.mark.parametrize(
    "pattern",
    ["sh_1001_64spp_{}.{{}}.exr", "sh_{}_{{}}_64spp.exr", "Shot01{}{{}}.exr", "Shot{}.{{}}.exr",
     "shot01_{}{{:04d}}.exr", "Abc{}_v02.{{}}.exr", "sh.{{}}.{}.exr"],
)  # fmt: skip
def test_labels_inside_of_names(tmp_path, pattern):
    labels = "Beauty", "Albedo", "WorldNormal", "ZDepth", "MotionVectors", "Reference"
    names = [pattern.format(label) for label in labels]
    layout = guess(a_file_each(tmp_path, *names))
    assert layout.buffers == {
        layer: (name.replace("{:04d}", "{}").replace("{}", "{frame}"),)
        for layer, name in zip(("color", "albedo", "normal", "depth", "motion", "reference"), names, strict=True)
    }
    assert open_sequence(tmp_path, preset=layout).numbers == (1, 2)


def test_letters_at_the_end_of_a_word_are_no_label(tmp_path):
    shot = a_file_each(tmp_path, "TakeN.{}.exr", "TakeN_albedo.{}.exr", "TakeNSpecularAlbedo.{}.exr")
    assert {layer: files for layer, (files,) in guess(shot).buffers.items()} == {
        "color": "TakeN.{frame}.exr", "albedo": "TakeN_albedo.{frame}.exr",
    }  # fmt: skip


@pytest.mark.parametrize("depth", [["V"], []])
def test_the_z_of_vectors_in_files_of_their_own_is_no_depth(tmp_path, depth):
    """As Blender's File Output node writes passes."""
    for name, written in {"Image": "RGBA", "Depth": depth, "Normal": "XYZ", "Vector": "XYZ"}.items():
        for number in (1, 2) if written else ():
            write_layers(tmp_path / f"{name}_{number:04d}.exr", {c: np.ones((4, 4), np.float32) for c in written})
    layout = guess(tmp_path)
    assert {layer: (*rules[0].channels, *layout.buffers[layer]) for layer, rules in layout.layers.items()} == {
        "color": ("color.R", "color.G", "color.B", "Image_{frame}.exr"),
        "normal": ("normal.X", "normal.Y", "normal.Z", "Normal_{frame}.exr"),
        "motion": ("motion.X", "motion.Y", "Vector_{frame}.exr"),
        **({"depth": ("depth.V", "Depth_{frame}.exr")} if depth else {}),
    }


UNLIKE = "{}.{{frame}}.exr is called otherwise than the picture, {}.{{frame}}.exr{}"
LEFT_OUT = ", and left out: describe it here if it belongs to the picture"
DOUBT = ": does it belong to it?"
OTHERS = {  # names of files -> layers that are described, and what is told of others
    "another camera": (("camA_beauty", "camA_albedo", "camB_albedo", "camB_depth"), {"albedo": "camA_albedo"}, {
        "depth": UNLIKE.format("camB_depth", "camA_beauty", LEFT_OUT)}),
    "another camera, which comes first": (("z_beauty", "z_depth", "a_depth"), {"depth": "z_depth"}, {}),
    "another camera's folder": (("A/beauty", "B/depth"), {"depth": "B/depth"}, {
        "depth": UNLIKE.format("B/depth", "A/beauty", DOUBT)}),
    "another version": (("s_beauty_v02", "s_depth_v02", "s_depth_v01", "s_albedo_v01"),
                        {"depth": "s_depth_v02", "albedo": "s_albedo_v01"}, {
        "albedo": UNLIKE.format("s_albedo_v01", "s_beauty_v02", DOUBT)}),
    "a longer name": (("s_beauty", "s_utility_depth"), {"depth": "s_utility_depth"}, {
        "depth": UNLIKE.format("s_utility_depth", "s_beauty", DOUBT)}),
    "a folder inside": (("s_beauty", "aov/s_depth", "aov/s_crypto"), {}, {
        "depth": "aov/s_depth.{frame}.exr is left out: it is in a folder inside; describe it here if it belongs to the "
                 "picture"}),
    "folders": (("beauty/s", "depth/s", "albedo/albedo_s"), {"depth": "depth/s", "albedo": "albedo/albedo_s"}, {}),
    "no name but the layer's": (("final", "depth", "s_albedo"), {"depth": "depth"}, {
        "albedo": UNLIKE.format("s_albedo", "final", LEFT_OUT)}),
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_files_of_another_picture_are_told(tmp_path, name):
    names, expected, told = OTHERS[name]
    shot, notes = a_file_each(tmp_path, *(f"{name}.{{}}.exr" for name in names)), {}
    layout = guess(shot, notes=notes)
    found = {layer: files for layer, (files,) in layout.buffers.items() if layer != "color"}
    assert found == {layer: f"{file}.{{frame}}.exr" for layer, file in expected.items()}
    assert notes == told


def test_what_is_told_of_files_is_written_and_printed(tmp_path, capsys):
    shot = a_file_each(tmp_path / "shot", "A_beauty.{}.exr", "A_z.{}.exr", "B_albedo.{}.exr")
    preset = tmp_path / "my.toml"
    main(["inspect", str(shot), "--write", str(preset)])
    told = "B_albedo.{frame}.exr is called otherwise than the picture, A_beauty.{frame}.exr, and left out"
    assert f"# albedo: {told}" in preset.read_text() and f"  albedo:      {told}" in capsys.readouterr().out


def test_a_glob_finds_the_layers_beside(tmp_path):
    shot = a_file_each(tmp_path, *(f"{name}.{{}}.exr" for name in (
        "sA_beauty", "sA_albedo", "sA_reference", "sB_beauty", "sB_depth", "sA_beauty_denoised")))  # fmt: skip
    glob, notes = str(shot / "sA_beauty.*.exr"), {}
    assert next_step(inspect(glob)).endswith("--write my.toml, which describes albedo: files beside seem to hold them")
    told = denoise(glob, tmp_path / "out", Options(model="fast")).notes
    assert ["files beside seem to hold it: rtdenoise inspect" in line for line in told[:2]] == [True, False]
    layout = guess(glob, notes=notes)
    assert {layer: files for layer, (files,) in layout.buffers.items()} == {
        "color": "sA_beauty.{frame}.exr", "albedo": "sA_albedo.{frame}.exr", "reference": "sA_reference.{frame}.exr",
    }  # fmt: skip
    assert list(notes) == ["depth"] and "sB_depth" in notes["depth"]
    assert open_sequence(str(shot / "sA_beauty.*2.exr"), preset=layout).numbers == (2,)
    assert guess(str(shot / "sA_*y.2.exr")).buffers.keys() == {"color", "albedo", "reference"}


def test_a_second_file_loses_no_layer_of_the_first(tmp_path):
    def made(frame):
        more = channels("reference.", frame["color"]) | channels("position.", frame["color"], "XYZ")
        more |= channels("large.", frame["color"]) | channels("small.", frame["color"] * 0)
        depth = channels("", frame["depth"].repeat(3, -1))
        return {"s.{}.exr": {**pictures(frame), **more, "id.I": np.ones((H, W))}, "s_depth.{}.exr": depth}

    shot, preset = write(tmp_path / "shot", made), tmp_path / "my.toml"
    write_description(shot, preset)
    available = open_sequence(shot, preset=str(preset)).available
    assert set(available) == {"radiance", "albedo", "depth", "reference", "position", "id", "components"}


def test_references_of_some_frames_are_left_out(tmp_path):
    shot, notes = a_file_each(tmp_path, "s_beauty.{}.exr", "s_reference.{}.exr"), {}
    (shot / "s_reference.2.exr").unlink()
    assert guess(shot, notes=notes).buffers.keys() == {"color"}
    assert notes == {"reference": "s_reference.{frame}.exr is left out: there is no such file of frame 2"}


def test_which_files_are_meant(tmp_path):
    shot = write(tmp_path / "shot", files("sh_{}.{{}}.exr"))
    more = "slate.{}.exr", "sh_crypto_albedo.{}.exr"
    write(shot, lambda f: {name: channels("", f["color"]) for name in more})
    assert describe(shot)[0].buffers["albedo"] == ("sh_diffuse_albedo.{frame}.exr",)
    (shot / "sh_depth.1002.exr").unlink()
    assert "depth has no such file of frame 1002, which color has" in message(describe, shot)
    takes = write(tmp_path / "takes", lambda f: {"a_v01.{}.exr": arnold(f), "a_v02.{}.exr": arnold(f)})
    assert "which is the picture, " in message(describe, takes)
    assert "motion" in describe(str(takes / "a_v01.*.exr"))[0].layers


@pytest.mark.parametrize("name", ["VRay{}.{{}}.exr", "a[1]{}.{{}}.exr", "a%{}.{{}}.exr", "\U0001f600{}.{{}}.exr"])
def test_odd_names(tmp_path, name):
    def made(frame):
        layers = {"": frame["color"], "DiffuseFilter": frame["albedo"], "Velocity": frame["motion"]}
        return {name.replace("{}", layer, 1).replace("{{}}", "{}"): channels(
            "", pixels, "RGB"[: pixels.shape[-1]]) for layer, pixels in layers.items()}  # fmt: skip

    shot, preset = write(tmp_path / "shot", made), tmp_path / "my.toml"
    if "[" in name:
        assert "cannot describe files called" in message(write_description, shot, preset)
        assert not preset.exists()
        return
    write_description(shot, preset)
    assert {"albedo", "motion"} <= set(open_sequence(shot, preset=str(preset)).rules)


@pytest.mark.parametrize(
    ("names", "layer", "expected"),
    [
        ("R G B C.R C.G C.B", "color", "R G B"),
        ("Ci.r Ci.g Ci.b R", "color", "Ci.r Ci.g Ci.b"),
        ("R G B specular_albedo.R specular_albedo.G specular_albedo.B", "albedo", None),
        ("R G B crypto_albedo.R albedo.red albedo.green albedo.blue", "albedo", "albedo.red albedo.green albedo.blue"),
        ("R G B VRayDiffuseFilter.R VRayDiffuseFilter.G VRayDiffuseFilter.B", "albedo", "VRayDiffuseFilter.*RGB"),
        ("R G B alb.R alb.G alb.B x.albedo.R x.albedo.G x.albedo.B", "albedo", "alb.R alb.G alb.B"),
        ("R G B NX NY NZ", "normal", "NX NY NZ"),
        ("R G B N.X N.Y N.Z __Nworld.r __Nworld.g __Nworld.b", "normal", "__Nworld.r __Nworld.g __Nworld.b"),
        ("R G B rgba.Z", "depth", None),
        ("R G B depth.R depth.G depth.B", "depth", "depth.R"),
        ("R G B Z", "depth", "Z"),
        ("R G B beauty:zdepth.V", "depth", "beauty:zdepth.V"),
        ("R G B velX velY", "motion", "velX velY"),
        ("R G B motionvectors.x motionvectors.y motionvectors.z", "motion", "motionvectors.x motionvectors.y"),
        ("R G B Motion.x", "motion", None),
        ("R G B FinalImageMovieRenderQueue_MotionVectors.R FinalImageMovieRenderQueue_MotionVectors.G", "motion",
         "FinalImageMovieRenderQueue_MotionVectors.*RG"),
    ],
)  # fmt: skip
def test_names(tmp_path, names, layer, expected):
    write_layers(tmp_path / "1.exr", {name: np.ones((4, 4), np.float32) for name in names.split()})
    found = guess(tmp_path).layers.get(layer)
    if expected and "*" in expected:
        base, _, endings = expected.partition("*")
        expected = " ".join(base + c for c in endings)
    assert (found and " ".join(found[0].channels)) == expected


def test_what_cannot_be_described(tmp_path):
    shot = tmp_path / "shot"
    shot.mkdir()
    write_layers(shot / "1.exr", {"foo": np.ones((4, 4, 3))})
    preset = tmp_path / "my.toml"
    assert "no channels that are called as a picture's; the file has foo.{R,G,B}" in message(
        write_description, shot, preset
    )
    assert not preset.exists()
    assert message(write_description, shot, tmp_path / "my.txt").endswith("ends in .toml, as presets of your own have")
    preset.write_text("")
    assert message(write_description, shot, preset) == f"--write {preset}: exists; name another file, or remove it"
    with pytest.raises(SystemExit, match="2"):
        main(["inspect", str(shot), "--write", str(preset), "--preset", "cycles"])


def test_text_and_layout_are_one(tmp_path):
    layout, notes = describe(write(tmp_path / "shot", files('{}/a "b" ü.{{}}.exr')))
    path = tmp_path / "guessed.toml"
    for mean in (False, True):
        layout = replace(layout, more_history=mean)
        path.write_text(layout_text(layout, notes))
        assert read_layout(path) == layout
