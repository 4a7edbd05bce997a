"""Files as Falcor, BMFR's data set and Open Image Denoise's training name them, and presets of one's own."""

from __future__ import annotations

import numpy as np
import pytest
from plane import FRAMES, H, W, buffers, camera
from synthetic import message

from rtdenoise.data.exr import read_channels, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.output import read_result
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.inspect import inspect
from rtdenoise.run.inspect_text import render_text


def write(path, image, names="RGB"):
    """One buffer as a file of its own, float as these programs write it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    planes = {name: image[..., i] for i, name in enumerate(names)}
    write_layers(path, planes, dtypes=dict.fromkeys(planes, "float"))


def write_falcor(folder, pattern="{}_{:04d}.exr", names=("color", "albedo", "normal", "linearZ", "mvec")):
    """RGBA files; mvec in fractions of the picture; linearZ with its derivative in G."""
    for number in range(FRAMES):
        b = buffers(number)
        z = np.concatenate([b["linear_z"], np.zeros((H, W, 1), np.float32)], -1)
        z[0, 0, 0] = np.finfo(np.float32).max  # a miss
        images = (b["color"], b["albedo"], b["normal"], z, b["motion"] / [W, H])
        for name, image in zip(names, images, strict=True):
            padded = np.concatenate([image, np.ones((H, W, 4 - image.shape[2]), np.float32)], -1)
            write(folder / pattern.format(name, number), padded, "RGBA")
    return folder


def write_bmfr(folder):
    """Three channels in single precision, numbers without zeros in front, and the cameras as a C header."""
    matrices = []
    for number in range(FRAMES):
        b = buffers(number)
        lit = b["color"] / b["albedo"]
        named = {"color": lit, "albedo": b["albedo"], "shading_normal": b["normal"], "world_position": b["position"]}
        for name, image in named.items():
            write(folder / f"{name}{number}.exr", image)
        x, y, w = camera(number)[0]
        clip = np.stack([2 * x / W - w, 2 * y / H - w, 0.9 * w - [0, 0, 0, 1], w]).T  # row vectors: (X, Y, Z, 1) M
        matrices.append("{" + ", ".join("{" + ", ".join(f"{v:.9f}f" for v in row) + "}" for row in clip) + "}")
    (folder / "camera_matrices.h").write_text(
        "const float position_limit_squared = 0.0001f;\nconst float normal_limit_squared = 1.0f;\n"
        f"const float camera_matrices[{FRAMES}][4][4] = {{\n" + ",\n".join(matrices) + "\n};\n"
        f"const float pixel_offsets[{FRAMES}][2] = {{ {', '.join(['{0.5f, 0.5f}'] * FRAMES)} }};\n"
    )
    return folder


def write_oidn(folder, spps=(4, 1)):
    for number in range(FRAMES):
        b = buffers(number)
        for spp in spps:
            named = {"hdr": b["color"] * spp, "alb": b["albedo"], "nrm": b["normal"]}
            for extension, image in named.items():
                write(folder / f"room_{number:03d}_{spp:04d}spp.{extension}.exr", image)
        write(folder / f"room_{number:03d}_ref.hdr.exr", b["color"] * 100)
    return folder


def is_close(tensor, image, tolerance=1e-6):
    return np.allclose(tensor[0].permute(1, 2, 0).numpy(), image, rtol=tolerance, atol=tolerance)


# --- Falcor -----------------------------------------------------------------------------------------------------------


CAPTURED = ("PathTracer.color", "PathTracer.albedo", "GBufferRT.normW", "GBufferRT.linearZ", "GBufferRT.mvec")


@pytest.mark.parametrize(
    ("pattern", "names"),
    [("{}_{:04d}.exr", ("color", "albedo", "normal", "linearZ", "mvec")), ("Mogwai.{}.{}.exr", CAPTURED)],
)
def test_falcor(tmp_path, pattern, names):
    sequence = open_sequence(write_falcor(tmp_path, pattern, names))
    assert (sequence.layout.name, sequence.numbers, sequence.size) == ("falcor", (0, 1, 2, 3), (H, W))
    frame, b = sequence[2], buffers(2)
    b["linear_z"][0, 0] = 0
    for layer, image in {"radiance": b["color"], "albedo": b["albedo"], "normal": b["normal"],
                         "depth": b["linear_z"], "motion": b["motion"]}.items():  # fmt: skip
        assert is_close(getattr(frame, layer), image, 1e-5), layer
    assert sequence.paths[2].name == pattern.format(names[0], 2)
    found = inspect(tmp_path)
    assert found.convention.status == "ok" and "motion_next" in found.missing
    assert "W·mvec.R, H·mvec.G" in render_text(found)


def test_falcor_is_denoised_into_its_color_files(tmp_path, model):
    shot = write_falcor(tmp_path / "shot")
    denoise(str(shot), tmp_path / "out", Options(model=model, layout="source"))
    assert sorted(p.name for p in (tmp_path / "out").glob("*.exr")) == [f"color_{i:04d}.exr" for i in range(FRAMES)]
    before, after = (read_channels(folder / "color_0002.exr", "RGBA") for folder in (shot, tmp_path / "out"))
    assert np.array_equal(before["A"], after["A"]) and not np.array_equal(before["R"], after["R"])


def test_a_frame_of_several_files_that_do_not_fit(tmp_path):
    folder = write_falcor(tmp_path)
    (folder / "albedo_0002.exr").unlink()
    found = message(open_sequence, folder)
    assert found.startswith(f"{folder / 'color_0002.exr'}: lacks albedo (channel albedo.R), which color_0000.exr has")
    write(folder / "albedo_0002.exr", np.ones((H, W + 1, 3), np.float32))
    assert message(open_sequence, folder) == (
        f"{folder / 'albedo_0002.exr'}: is {W + 1}×{H}, expected {W}×{H} as color_0002.exr"
    )


def test_a_glob_picks_frames_by_any_file(tmp_path):
    folder = write_falcor(tmp_path)
    sequence = open_sequence(str(folder / "color_000[12].exr"))
    assert sequence.numbers == (1, 2) and sequence[0].albedo is not None
    write_layers(folder / "frame.0007.exr", {"color": np.ones((H, W, 3))})
    assert open_sequence(folder / "frame.0007.exr").layout.name == "native"
    write(folder / "sub" / "Other.color.3.exr", np.ones((H, W, 3)))
    write(folder / "sub" / "Mogwai.color.3.exr", np.ones((H, W, 3)))
    assert message(open_sequence, folder / "sub", preset="falcor").startswith(
        f"{folder / 'sub' / 'Other.color.3.exr'}: frame number 3 is there twice, Mogwai.color.3.exr has it too; give a"
    )
    assert message(open_sequence, folder, preset="bmfr") == (
        f"{folder}: no file is named like any of color{{frame}}.exr, albedo{{frame}}.exr, shading_normal{{frame}}.exr, "
        "world_position{frame}.exr"
    )


# --- BMFR -------------------------------------------------------------------------------------------------------------


def test_bmfr(tmp_path):
    sequence = open_sequence(write_bmfr(tmp_path))
    assert sequence.layout.name == "bmfr" and sequence.demodulated
    assert sequence.require("depth", "motion", "motion_next") is sequence
    frame, b = sequence[1], buffers(1)
    assert is_close(frame.radiance, np.full((H, W, 3), 2.0), 1e-5) and is_close(frame.albedo, b["albedo"])
    assert is_close(frame.depth, b["depth"], 1e-4) and is_close(frame.motion, b["motion"], 1e-3)
    assert sequence[0].motion is None and sequence[FRAMES - 1].motion_next is None
    found = inspect(tmp_path)
    assert found.convention.status == "ok" and found.computed == ("depth", "id", "motion", "motion_next")


def test_bmfr_recombined_is_multiplied_by_the_albedo(tmp_path, model):
    shot = write_bmfr(tmp_path / "shot")
    common = {"model": model, "float32": True}
    denoise(str(shot), tmp_path / "lit", Options(**common))
    denoise(str(shot), tmp_path / "beauty", Options(**common, recombine=True))
    lit, beauty = (read_channels(tmp_path / name / "color3.exr", "RGB") for name in ("lit", "beauty"))
    albedo = read_channels(shot / "albedo3.exr", "RGB")
    for c in "RGB":
        assert np.array_equal(beauty[c], lit[c] * albedo[c])


def test_bmfr_cameras_that_do_not_fit(tmp_path):
    folder = write_bmfr(tmp_path)
    header = folder / "camera_matrices.h"
    header.write_text("int x;")
    assert message(open_sequence, folder) == (
        f"{header}: expected an array 'camera_matrices[…][4][4] = {{…}};', found none"
    )
    header.write_text("const float camera_matrices[1][4][4] = {{{1, 2}}};")
    assert "camera_matrices holds 2 numbers, expected 16 for each frame" in message(open_sequence, folder)
    header.write_text("const float camera_matrices[1][4][4] = {" + "0, " * 16 + "};")
    assert "the matrix of frame 0 is not that of a perspective camera" in message(open_sequence, folder)
    header.unlink()
    assert "put camera_matrices.h beside the frames" in message(open_sequence(folder).require, "motion")


# --- Open Image Denoise -----------------------------------------------------------------------------------------------


def test_oidn_takes_the_lowest_number_of_samples(tmp_path):
    sequence = open_sequence(write_oidn(tmp_path), layers=["reference"])
    assert (sequence.layout.name, sequence.numbers) == ("oidn", (0, 1, 2, 3))
    frame, b = sequence[3], buffers(3)
    for layer, image in {"radiance": b["color"], "albedo": b["albedo"], "normal": b["normal"],
                         "reference": b["color"] * 100}.items():  # fmt: skip
        assert is_close(getattr(frame, layer), image), layer
    assert sequence.paths[3].name == "room_003_0001spp.hdr.exr"
    assert open_sequence(str(tmp_path / "*_0004spp*")).paths[3].name == "room_003_0004spp.hdr.exr"
    assert "no layer 'depth' (oidn layout)" in message(sequence.require, "depth")


def test_oidn_without_frame_numbers(tmp_path):
    for name in ("hdr", "alb"):
        write(tmp_path / f"room_0001spp.{name}.exr", buffers(0)["albedo"])
    assert open_sequence(tmp_path).numbers == (0,)


# --- presets of one's own ---------------------------------------------------------------------------------------------


TRACER = """
name = "tracer"
demodulated = ["indirect"]
[color]
channels = ["R", "G", "B"]
file = "beauty/{frame}.exr"
[indirect]
channels = ["R", "G", "B"]
file = "gi/{frame}.exr"
[albedo]
channels = ["R", "G", "B"]
file = "*.alb.{frame}.exr"
[normal]
channels = ["X", "Y", "Z"]
file = "n{frame}.exr"
[depth]
channels = ["Z"]
miss = 1e9
file = "z{frame}.exr"
[motion]
channels = ["v", "u"]
signs = [-1, 1]
scale = "uv"
file = "velocity{frame}.exr"
"""


def write_tracer(folder):
    """Folders and names of one's own; motion as (row, −column), in fractions, y up."""
    for number in range(FRAMES):
        b = buffers(number)
        write(folder / f"beauty/{number}.exr", b["color"])
        write(folder / f"gi/{number}.exr", 0.5 + 0 * b["color"])
        write(folder / f"v2.alb.{number}.exr", b["albedo"])
        write(folder / f"n{number}.exr", b["normal"], "XYZ")
        b["depth"][:2] = 1e10
        write(folder / f"z{number}.exr", b["depth"], "Z")
        write(folder / f"velocity{number}.exr", b["motion"] / [W, H] * [-1, 1], "vu")
    (folder / "tracer.toml").write_text(TRACER)
    return folder


def test_a_preset_file(tmp_path):
    write_tracer(tmp_path)
    sequence = open_sequence(tmp_path, preset=str(tmp_path / "tracer.toml"))
    assert (sequence.layout.name, sequence.numbers, sequence.demodulated) == ("tracer", (0, 1, 2, 3), False)
    frame, b = sequence[2], buffers(2)
    b["depth"][:2] = 0
    for layer, image in {"radiance": b["color"], "albedo": b["albedo"], "normal": b["normal"], "depth": b["depth"],
                         "motion": b["motion"]}.items():  # fmt: skip
        assert is_close(getattr(frame, layer), image, 1e-5), layer
    assert inspect(tmp_path, preset=str(tmp_path / "tracer.toml")).convention.status == "ok"


def test_two_layers_may_be_of_the_same_channels_of_a_file(tmp_path):
    write_tracer(tmp_path)
    own = TRACER + """
[position]
channels = ["X", "Y", "Z"]
file = "n{frame}.exr"
"""
    (tmp_path / "tracer.toml").write_text(own)
    frame = open_sequence(tmp_path, preset=str(tmp_path / "tracer.toml"), layers=("position",))[1]
    assert (frame.position == frame.normal).all() and is_close(frame.normal, buffers(1)["normal"])


def test_a_channel_that_a_buffers_file_lacks_is_named(tmp_path):
    write_tracer(tmp_path)
    (tmp_path / "tracer.toml").write_text(TRACER.replace('"Z"', '"A"'))
    sequence = open_sequence(tmp_path, preset=str(tmp_path / "tracer.toml"))
    assert "the file has color.{R,G,B}" in (found := message(sequence.require, "depth")) and "depth.Z" in found
    assert "write it as A in z{frame}.exr, or name it in" in found


def test_a_preset_file_for_one_file_with_all_layers(tmp_path):
    (tmp_path / "p.toml").write_text('more_history = true\n[color]\nchannels = ["a", "b", "c"]')
    write(tmp_path / "s" / "f.1.exr", buffers(0)["color"], "abc")
    frame = open_sequence(tmp_path / "s", preset=tmp_path / "p.toml")[0]
    assert is_close(frame.radiance, buffers(0)["color"]) and frame.more_history


def test_recombined_into_the_files_of_both_signals(tmp_path, model):
    shot = write_tracer(tmp_path / "shot")
    options = Options("indirect", model, str(shot / "tracer.toml"), layout="source", recombine=True, float32=True)
    denoise(str(shot), tmp_path / "out", options)
    indirect = read_channels(tmp_path / "out" / "2.exr", "RGB")
    beauty = read_channels(tmp_path / "out" / "beauty.2.exr", "RGB")
    b = buffers(2)
    for i, c in enumerate("RGB"):
        expected = b["color"][..., i] + (indirect[c] - 0.5) * b["albedo"][..., i]
        np.testing.assert_allclose(beauty[c], expected.clip(0), atol=1e-6)
    sequence = open_sequence(shot, signal="indirect", preset=options.preset)
    for recombine, planes in ((False, indirect), (True, beauty)):
        result = read_result(tmp_path / "out", sequence, 2, "source", recombine)
        assert np.array_equal(result[0], np.stack([planes[c] for c in "RGB"]))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[color", "not valid TOML"),
        ("name = 3", "name is 3, expected a string"),
        ("demodulated = [3, {}]", "demodulated is [3, {}], expected a list of color, indirect"),
        ("demodulated = [[]]", "demodulated is [[]], expected a list of color, indirect"),
        ("name = [" + "3, " * 1000 + "]", "name is [3, 3, 3, 3, 3, 3, ...], expected a string"),
        ("x = " + "[" * 5000, "not valid TOML: "),
        ('[depth]\nchannels = ["Z"]\nmiss = ' + "9" * 400, "[depth] miss is 999999999"),
        ('[depth]\nchannels = ["Z"]\nmiss = ' + "9" * 5000, "not valid TOML: "),
        ('[depth]\nchannels = ["Z"]\nmiss = nan', "[depth] miss is nan, expected a number above 0, for depth only"),
        ('[depth]\nchannels = ["Z"]\nmiss = true', "[depth] miss is True, expected a number above 0, for depth only"),
        ('[depth]\nchannels = ["Z"]\nmiss = -1', "[depth] miss is -1, expected a number above 0, for depth only"),
        ('[motion]\nchannels = ["X", "Y"]\nsigns = [true, 1]', "[motion] signs is [True, 1], expected 2 times 1 or -1"),
        ('[motion]\nchannels = ["X", "Y"]\nscale = ["uv"]', "[motion] scale is ['uv'], expected a number above 0, for"),
        ('[depth]\nchannels = ["Z"]\nfile = "{frame}/{frame}.exr"', "[depth] file is '{frame}/{frame}.exr', expected"),
        ('[depth]\nchannels = ["Z"]\nfile = "{spp}{spp}.{frame}.exr"', "[depth] file is '{spp}{spp}.{frame}.exr', exp"),
        ('[depth]\nchannels = ["Z"]\nfile = "../{frame}.exr"', "[depth] file is '../{frame}.exr', expected a pattern"),
        ('[depth]\nchannels = ["Z"]\nfile = "{take}.{frame}.exr"', "[depth] file is '{take}.{frame}.exr', expected a"),
        ("more_history = 1", "more_history is 1, expected true or false"),
        ('demodulated = "indirect"', "demodulated is 'indirect', expected a list of color, indirect"),
        ("[colour]\nchannels = []", "unknown layer 'colour' (did you mean 'color'?); known are color, "),
        ("color = 3", "color is 3, expected a table [color]"),
        ('[depth]\nchannels = ["Z"]', "describes no signal; expected a table [color] or [indirect]"),
        ('[color]\nchanels = ["R"]', "[color] unknown key 'chanels' (did you mean 'channels'?); known are channels,"),
        ('[color]\nchannels = ["R"]', "[color] channels is ['R'], expected 3 channel names"),
        ('[depth]\nchannels = "Z"', "[depth] channels is 'Z', expected 1 channel name"),
        ('[motion]\nchannels = ["X", "Y"]\nsigns = [1, 2]', "[motion] signs is [1, 2], expected 2 times 1 or -1"),
        ('[motion]\nchannels = ["X", "Y"]\nscale = "px"', "[motion] scale is 'px', expected a number above 0, for "),
        ('[motion]\nchannels = ["X", "Y"]\nscale = 0', "[motion] scale is 0, expected a number above 0, for motion"),
        ('[motion]\nchannels = ["X", "Y"]\nscale = inf', "[motion] scale is inf, expected a number above 0"),
        ('[normal]\nchannels = ["X", "Y", "Z"]\nscale = "uv"', "[normal] scale is 'uv', expected a number above 0"),
        ('[normal]\nchannels = ["X", "Y", "Z"]\noffset = "a"', "[normal] offset is 'a', expected a number"),
        ('[motion]\nchannels = ["X", "Y"]\noffset = nan', "[motion] offset is nan, expected a number"),
        ('[depth]\nchannels = ["Z"]\nscale = 2', "[depth] scale and offset are for motion and normal only"),
        ('[albedo]\nchannels = ["R", "G", "B"]\noffset = 0.5', "[albedo] scale and offset are for motion and normal"),
        ('[depth]\nchannels = ["Z"]\nscale = "uv"', "[depth] scale is 'uv', expected"),
        ('[depth]\nchannels = ["Z"]\nmiss = "far"', "[depth] miss is 'far', expected a number above 0, for depth only"),
        ('[depth]\nchannels = ["Z"]\nfile = "z.exr"', "[depth] file is 'z.exr', expected a pattern in the sequence's"),
        (
            '[color]\nchannels = ["R", "G", "B"]\nfile = "c{frame}.exr"\n[depth]\nchannels = ["Z"]',
            "[depth] has no 'file', [color] has one; give all layers a file, or none where one file holds all of them",
        ),
    ],
)
def test_a_preset_file_that_is_wrong(tmp_path, text, expected):
    path = tmp_path / "my.toml"
    path.write_text(text)
    assert message(open_sequence, tmp_path, preset=str(path)).startswith(f"{path}: {expected}")


def test_a_preset_file_that_is_not_there(tmp_path):
    found = message(open_sequence, tmp_path, preset=str(tmp_path / "my.toml"))
    assert found == f"{tmp_path / 'my.toml'}: cannot be read: No such file or directory"
