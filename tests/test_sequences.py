"""Sequences: their files, the layers of each renderer as frames, and messages about layers that are missing."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import torch
from synthetic import message

from rtdenoise.data import layouts, recognise
from rtdenoise.data.exr import read_header, write_layers
from rtdenoise.data.files import number_files
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.output import write_frame
from rtdenoise.frame import OFF_SCREEN

H, W = 12, 16
NATIVE = {"color": 3, "indirect": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "motion_next": 2,
          "reference": 3, "indirect_reference": 3, "reference_half": 3, "indirect_reference_half": 3}  # fmt: skip
FLOAT = dict.fromkeys(NATIVE, "float")
CYCLES = {  # pass -> components, as Blender 5 names them
    "Combined": "RGBA", "Noisy Image": "RGB", "Denoising Albedo": "RGB", "Denoising Normal": "XYZ", "Normal": "XYZ",
    "Denoising Depth": "Z", "Depth": "Z", "Position": "XYZ", "Vector": "XYZW", "Diffuse Direct": "RGB",
    "Diffuse Indirect": "RGB", "Diffuse Color": "RGB", "Object Index": "X", "Mist": "Z",
}  # fmt: skip
MITSUBA = ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "nn.X", "nn.Y", "nn.Z", "dd.y.T", "pos.X", "pos.Y",
           "pos.Z", "id.I", "uv.U", "uv.V", "img.R", "img.G", "img.B", "img.A"]  # fmt: skip


def native_layers(seed):
    rng = np.random.default_rng(seed)
    return {layer: rng.random((H, W, count), dtype=np.float32) for layer, count in NATIVE.items()}


def write_native(folder, numbers, without=(), name="frame.{:04d}.exr"):
    folder.mkdir(exist_ok=True)
    for number in numbers:
        layers = {k: v for k, v in native_layers(number).items() if k not in without}
        write_layers(folder / name.format(number), layers, dtypes=FLOAT)
    return folder


def write_cycles(path, view_layers=("ViewLayer",), passes=CYCLES):
    """A multi-part file as Blender writes it. Returns channel name -> [H, W]."""
    rng = np.random.default_rng(0)
    parts, planes = [], {}
    for view_layer in view_layers:
        for name, components in passes.items():
            channels = {f"{view_layer}.{name}.{c}": rng.random((H, W), dtype=np.float32) for c in components}
            planes |= channels
            header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
            parts.append(OpenEXR.Part(header, dict(channels), f"{view_layer}.{name}"))
    OpenEXR.File(parts).write(str(path))
    return planes


def stacked(planes, *names, signs=(1, 1, 1)):
    return torch.from_numpy(np.stack([s * planes[n] for n, s in zip(names, signs, strict=False)]))[None]


# --- frames -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("signal", ["color", "indirect"])
def test_a_native_sequence(tmp_path, signal):
    sequence = open_sequence(
        write_native(tmp_path / "s", range(3)), signal=signal, layers=["reference", "reference_half"]
    )
    assert (len(sequence), sequence.numbers, sequence.size, sequence.gaps) == (3, (0, 1, 2), (H, W), ())
    assert sequence.layout.name == "native" and not sequence.demodulated and sequence.scene is None
    suffix = {"color": "", "indirect": "indirect_"}[signal]
    sources = {"radiance": signal, "reference": f"{suffix}reference", "reference_half": f"{suffix}reference_half"}
    for number, frame in enumerate(sequence):
        assert (frame.number, frame.name) == (number, str(tmp_path / "s" / f"frame.{number:04d}.exr"))
        written = native_layers(number)
        for layer, tensor in frame.layers():
            expected = torch.from_numpy(written[sources.get(layer, layer)]).permute(2, 0, 1)[None]
            assert tensor.dtype == torch.float32 and torch.equal(tensor, expected), layer
    assert sequence[-1].number == 2
    with pytest.raises(IndexError):
        sequence[3]


def test_only_needed_layers_are_read(tmp_path):
    folder = write_native(tmp_path / "s", range(1))
    default = {"radiance", "albedo", "normal", "depth", "motion", "motion_next"}
    assert {layer for layer, _ in open_sequence(folder)[0].layers()} == default
    more = open_sequence(folder, layers=["reference", "position"])[0]
    assert {layer for layer, _ in more.layers()} == {*default, "reference"}
    assert open_sequence(folder, layers="reference")[0].reference is not None
    few = open_sequence(write_native(tmp_path / "t", range(1), without=("motion_next", "normal")))[0]
    assert few.motion_next is None and few.normal is None and few.motion is not None


def test_non_finite_pixels_are_passed_on_except_infinite_depth(tmp_path):
    layers = native_layers(0)
    layers["color"][0, 0] = np.nan
    layers["color"][0, 1] = np.inf
    layers["depth"][0, :3, 0] = [np.inf, np.nan, 0]
    write_layers(tmp_path / "1.exr", layers, dtypes=FLOAT)
    frame = open_sequence(tmp_path)[0]
    assert frame.radiance[0, :, 0, 0].isnan().all() and frame.radiance[0, :, 0, 1].isinf().all()
    np.testing.assert_array_equal(frame.depth[0, 0, 0, :3], [0, np.nan, 0])


# --- presets ----------------------------------------------------------------------------------------------------------


def test_cycles_passes_become_the_canon(tmp_path):
    planes = {k.removeprefix("ViewLayer."): v for k, v in write_cycles(tmp_path / "render_0001.exr").items()}
    color = open_sequence(tmp_path, layers=["position", "id"])
    assert color.layout.name == "cycles" and not color.demodulated
    frame = color[0]
    assert frame.more_history and not open_sequence(write_native(tmp_path / "own", [1]))[0].more_history
    assert torch.equal(frame.radiance, stacked(planes, "Noisy Image.R", "Noisy Image.G", "Noisy Image.B"))
    assert torch.equal(frame.albedo, stacked(planes, *(f"Denoising Albedo.{c}" for c in "RGB")))
    assert torch.equal(frame.normal, stacked(planes, "Normal.X", "Normal.Y", "Normal.Z"))  # in world space
    assert torch.equal(frame.depth, stacked(planes, "Depth.Z"))
    assert torch.equal(frame.motion, stacked(planes, "Vector.X", "Vector.Y", signs=(1, -1)))
    assert torch.equal(frame.motion_next, stacked(planes, "Vector.Z", "Vector.W", signs=(-1, 1)))
    assert torch.equal(frame.position, stacked(planes, "Position.X", "Position.Y", "Position.Z"))
    assert torch.equal(frame.id, stacked(planes, "Object Index.X"))

    indirect = open_sequence(tmp_path, signal="indirect")
    assert indirect.demodulated
    assert torch.equal(indirect[0].radiance, stacked(planes, *(f"Diffuse Indirect.{c}" for c in "RGB")))
    assert torch.equal(indirect[0].albedo, stacked(planes, *(f"Diffuse Color.{c}" for c in "RGB")))


def test_short_cycles_names_and_the_depth_of_misses(tmp_path):
    channels = [f"RenderLayer.{p}.{c}" for p in ("Combined", "DiffInd", "DiffCol") for c in "RGB"]
    layers = {
        **dict.fromkeys([*channels, "RenderLayer.IndexOB.X"], np.ones((H, W))),
        "RenderLayer.Depth.Z": np.full((H, W), 1e10),
    }
    write_layers(tmp_path / "1.exr", layers, dtypes=dict.fromkeys(layers, "float"))
    frame = open_sequence(tmp_path, signal="indirect", layers=["id"])[0]
    assert (frame.depth == 0).all() and (frame.id == 1).all() and (frame.albedo == 1).all()
    assert open_sequence(tmp_path).rules["radiance"].channels[0] == "RenderLayer.Combined.R"


@pytest.mark.parametrize("standing", [0.0, 0.5])
def test_cycles_sky_has_no_history_while_the_camera_moves(tmp_path, standing):
    """Its motion is zero, whatever the camera does."""
    path = tmp_path / "render_0001.exr"
    planes = write_cycles(path)
    surface, still = np.s_[H // 2 :], np.s_[H // 2 :, : round(standing * W)]
    for name in ("Depth.Z", *(f"Vector.{c}" for c in "XYZW")):
        plane = planes[f"ViewLayer.{name}"]
        plane[: H // 2] = 1e10 if name == "Depth.Z" else 0
        plane[surface] += 1
        plane[still] = 1 if name == "Depth.Z" else 0
    write_layers(path, planes, dtypes=dict.fromkeys(planes, "float"))
    frame = open_sequence(tmp_path)[0]
    for motion in (frame.motion, frame.motion_next):
        assert (motion[..., : H // 2, :] == (0 if standing else OFF_SCREEN)).all()
        assert (motion[..., H // 2 :, :].abs() < 100).all()


def test_several_view_layers_have_to_be_chosen_from(tmp_path):
    planes = write_cycles(tmp_path / "1.exr", ("Composite", "Sky", "Main"), {"Combined": "RGB"})
    assert message(open_sequence, tmp_path) == (
        f"{tmp_path / '1.exr'}: several view layers (Sky, Main): choose one, e.g. preset cycles:Sky"
    )
    assert "no view layer 'Mian'; the file has Sky, Main" in message(open_sequence, tmp_path, preset="cycles:Mian")
    frame = open_sequence(tmp_path, preset="cycles:Main")[0]
    assert torch.equal(frame.radiance, stacked(planes, *(f"Main.Combined.{c}" for c in "RGB")))


def test_a_view_layer_with_a_space_is_quoted_as_a_shell_needs_it(tmp_path):
    write_cycles(tmp_path / "1.exr", ("Far away", "Main"), {"Combined": "RGB"})
    assert message(open_sequence, tmp_path).endswith("choose one, e.g. preset 'cycles:Far away'")


def test_the_compositors_result_serves_when_it_is_alone(tmp_path):
    write_cycles(tmp_path / "1.exr", ("Composite",), {"Combined": "RGBA"})
    assert open_sequence(tmp_path).rules["radiance"].channels[0] == "Composite.Combined.R"


def test_mitsuba_aovs_become_the_canon(tmp_path):
    """The names are those that Mitsuba 3.9's aov integrator gives to
    `albedo:albedo,nn:sh_normal,dd.y:depth,pos:position,id:shape_index,uv:uv` around an integrator called `img`."""
    planes = {name: np.full((H, W), i, np.float32) for i, name in enumerate(MITSUBA)}
    write_layers(tmp_path / "1.exr", planes)
    sequence = open_sequence(tmp_path, layers=["position", "id"])
    assert sequence.layout.name == "mitsuba"
    frame = sequence[0]
    for layer, names in {"radiance": "R G B", "albedo": "albedo.R albedo.G albedo.B", "normal": "nn.X nn.Y nn.Z",
                         "depth": "dd.y.T", "position": "pos.X pos.Y pos.Z", "id": "id.I"}.items():  # fmt: skip
        assert torch.equal(getattr(frame, layer), stacked(planes, *names.split())), layer
    hint = "Mitsuba has no motion AOV: render with `rtdenoise render`, or add channels motion.X, motion.Y"
    assert message(sequence.require, "depth", "motion").endswith(f"; {hint}")


def test_normals_of_vray_are_not_taken_for_mitsubas(tmp_path):
    """They are in the camera's space."""
    vray = ("R", "G", "B", "A", "Z", *(f"{layer}.{c}" for layer in ("normals", "velocity") for c in "XYZ"))
    write_layers(tmp_path / "1.exr", {name: np.ones((H, W), np.float32) for name in vray})
    sequence = open_sequence(tmp_path)
    assert sequence.layout is layouts.NATIVE and sequence[0].normal is None
    write_layers(tmp_path / "1.exr", {name: np.ones((H, W), np.float32) for name in (*vray, "depth.T")})
    assert open_sequence(tmp_path).layout is layouts.MITSUBA


def test_plain_pictures_are_native(tmp_path):
    write_layers(tmp_path / "1.exr", {"color": np.ones((H, W, 3)), "albedo": np.ones((H, W, 3))})
    assert open_sequence(tmp_path).layout is layouts.NATIVE


def test_presets_that_do_not_fit(tmp_path):
    folder = write_native(tmp_path / "s", range(1))
    assert message(open_sequence, folder, preset="cylces") == (
        "unknown preset 'cylces' (did you mean 'cycles'?): known are auto, native, cycles, mitsuba, falcor, "
        "bmfr, oidn, noisebase, or a .toml file"
    )
    assert message(open_sequence, folder, preset="xyz").startswith("unknown preset 'xyz': known are auto")
    assert "no <ViewLayer>.Combined.R as Cycles writes it among R,G,B" in message(
        open_sequence, folder, preset="cycles"
    )
    write_layers(tmp_path / "1.exr", {"foo": np.ones((H, W, 3)), "bar": np.ones((H, W, 1))})
    found = message(recognise.detect, read_header(tmp_path / "1.exr"))
    assert "no known layout (presets: native, cycles, mitsuba, falcor, bmfr, oidn, noisebase)" in found
    assert found.endswith("among bar.V, foo.{R,G,B}; describe your files (rtdenoise inspect SEQ --write my.toml)")


# --- missing layers ---------------------------------------------------------------------------------------------------


def test_a_missing_signal(tmp_path):
    folder = write_native(tmp_path / "s", range(1), without=("indirect",))
    found = message(open_sequence, folder, signal="indirect")
    assert found.startswith(
        f"{folder / 'frame.0000.exr'}: no signal 'indirect' (native layout); the file has R,G,B, albedo."
    )
    assert found.endswith(
        "choose the signal 'color', which is there, or write it as indirect.R, indirect.G, indirect.B, or name it in a "
        "layout of your own (--preset my.toml)"
    )
    assert message(open_sequence, folder, signal="direct") == "unknown signal 'direct': known are color, indirect"
    assert message(open_sequence, folder, layers=["normals"]).startswith(
        "unknown layer 'normals': known are radiance, "
    )
    wrong = message(open_sequence, folder, preset=3)
    assert wrong == "preset: expected the name of a layout or a .toml file, got int"
    for asked in (open_sequence(folder).require, open_sequence(folder).only):
        assert message(asked, "normals").startswith("unknown layer 'normals': known are radiance, ")
    assert open_sequence(folder).only("radiance").rules.keys() == {"radiance"}
    assert message(open_sequence, folder, layers="normals").startswith("unknown layer 'normals': known are radiance, ")


def test_a_required_layer_that_is_missing_says_what_to_switch_on(tmp_path):
    write_cycles(tmp_path / "1.exr", passes={"Combined": "RGBA", "Depth": "Z"})
    sequence = open_sequence(tmp_path)
    assert sequence.require("radiance", "depth") is sequence
    assert message(sequence.require, "depth", "motion") == (
        f"{tmp_path / '1.exr'}: no layer 'motion' (cycles layout); the file has ViewLayer.Combined.{{R,G,B,A}}, "
        "ViewLayer.Depth.Z; switch on View Layer > Passes > Data > Vector, and motion blur off"
    )


# --- files ------------------------------------------------------------------------------------------------------------


def test_files_are_sorted_by_number(tmp_path):
    folder = write_native(tmp_path / "v2", [8, 9, 10, 11], name="shot7_{}.exr")
    (folder / "notes.txt").touch()
    (folder / ".shot7_12.exr.tmp.exr").touch()  # unfinished
    assert open_sequence(folder).numbers == (8, 9, 10, 11)
    assert open_sequence(str(folder / "shot7_1*.exr")).numbers == (10, 11)
    assert open_sequence(folder / "shot7_9.exr").numbers == (9,)


def test_a_slice_is_a_sequence(tmp_path):
    sequence = open_sequence(write_native(tmp_path / "shot", range(10, 16)))
    middle, second = sequence[1:-1], sequence[::2]
    assert middle.numbers == (11, 12, 13, 14) and middle.gaps == () and len(middle) == 4
    assert [frame.number for frame in middle] == [11, 12, 13, 14]
    assert torch.equal(middle[0].radiance, sequence[1].radiance)
    assert second.numbers == (10, 12, 14) and second.gaps == ((11, 11), (13, 13)) and len(sequence[6:]) == 0
    assert message(sequence.__getitem__, slice(None, None, -1)).endswith("reversed(sequence) for its frames backwards")
    assert [frame.number for frame in reversed(sequence)] == [15, 14, 13, 12, 11, 10]


def test_places_without_a_sequence(tmp_path):
    gone = tmp_path / "gone"
    assert message(open_sequence, gone) == f"{gone}: does not exist; give a folder of EXR files or a glob"
    assert message(open_sequence, os.devnull).startswith(f"{os.devnull}: is no regular file; give a folder")
    for counter in ("####", "@", "%04d", "%d", "$F4", "${F}", "<F4>"):
        assert message(open_sequence, gone / f"v3.{counter}.exr").endswith(f" in quotes: '{gone / 'v3.*.exr'}'")
    assert message(open_sequence, gone / "*.exr") == f"{gone / '*.exr'}: no file fits this glob"
    assert message(open_sequence, tmp_path) == f"{tmp_path}: no .exr file in this folder: it is empty"
    (tmp_path / "a.png").touch()
    assert message(open_sequence, tmp_path) == f"{tmp_path}: no .exr file in this folder: it holds 1 file, e.g. a.png"


def test_what_is_no_exr_file_in_a_glob_is_left_out(tmp_path):
    folder = write_native(tmp_path / "s", [1, 2])
    (folder / "notes.txt").touch()
    assert open_sequence(folder / "*").numbers == (1, 2)


def test_frame_numbers_that_are_missing_or_there_twice(tmp_path):
    folder = write_native(tmp_path / "s", [1, 2, 4, 8])
    assert message(open_sequence, folder) == (
        f"{folder / 'frame.0002.exr'}: the next frame is 4, missing: 3; render what is missing, or let denoise, "
        "combine or inspect allow gaps (--allow-gaps): history then starts anew after each"
    )
    assert open_sequence(folder, allow_gaps=True).gaps == ((3, 3), (5, 7))
    shutil.copy(folder / "frame.0002.exr", folder / "frame.02.exr")
    assert message(open_sequence, folder, allow_gaps=True) == (
        f"{folder / 'frame.02.exr'}: frame number 2 is there twice, frame.0002.exr has it too; "
        "give a glob that fits one file a frame; where each layer has a file, rtdenoise inspect DIR --write my.toml "
        "describes them"
    )
    shutil.copy(folder / "frame.0002.exr", folder / "beauty.exr")
    assert message(open_sequence, folder) == (
        f"{folder / 'beauty.exr'}: no frame number in the name; expected digits, as in frame.0001.exr"
    )


@pytest.mark.parametrize(
    ("runs", "numbers"),
    [
        (["-0001", "0000", "0001"], (-1, 0, 1)),
        (["-0002", "-0001"], (-2, -1)),
        (["-0000", "-0001", "-0002"], (0, 1, 2)),  # there is no frame -0
        (["-1001", "-1002"], (1001, 1002)),
    ],
)
def test_a_dash_before_frame_numbers_is_a_sign_where_it_can_be_one(runs, numbers):
    files = [Path(f"v2.{run}.exr") for run in runs]
    assert number_files(files[::-1]) == list(zip(numbers, files, strict=True))


def test_frames_that_differ_from_the_first(tmp_path):
    folder = write_native(tmp_path / "s", range(3))
    layers = native_layers(1)
    write_layers(folder / "frame.0001.exr", {k: v for k, v in layers.items() if k != "normal"}, dtypes=FLOAT)
    found = message(open_sequence, folder)
    assert found.startswith(
        f"{folder / 'frame.0001.exr'}: lacks normal (channel normal.X), which frame.0000.exr has; the file has R,"
    )
    write_layers(folder / "frame.0001.exr", {k: v[:, 1:] for k, v in layers.items()}, dtypes=FLOAT)
    assert message(open_sequence, folder) == (
        f"{folder / 'frame.0001.exr'}: is {W - 1}×{H}, expected {W}×{H} as frame.0000.exr; all frames of a sequence "
        "must have one size"
    )
    (folder / "frame.0001.exr").write_bytes(b"")
    assert message(open_sequence, folder) == f"{folder / 'frame.0001.exr'}: the file is empty (0 bytes)"


# --- scene.json -------------------------------------------------------------------------------------------------------


def scene_document():
    """A camera that sees one world unit as a pixel at a distance of 1, and moves by 2 along x every frame."""
    frames = []
    for number in range(-1, 4):
        to_pixel = np.array([[1.0, 0, 0, -2 * number], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]])
        frames.append({"number": number, "world_to_pixel": to_pixel.tolist(), "camera_origin": [2.0 * number, 0, 0],
                       "object_to_world": {"1": np.eye(4).tolist()}})  # fmt: skip
    return {"format": "rtdenoise-scene-1", "width": W, "height": H, "objects": {"1": "wall"}, "frames": frames}


def test_motion_is_computed_from_the_scene(tmp_path):
    y, x = np.mgrid[:H, :W] + 0.5
    for number in range(3):
        position = np.stack([x + 2 * number, y, np.ones_like(x)], -1)
        layers = {"color": np.ones((H, W, 3)), "position": position, "id": np.ones((H, W, 1))}
        write_layers(tmp_path / f"{number}.exr", layers)
    assert open_sequence(tmp_path)[1].motion is None
    (tmp_path / "scene.json").write_text(json.dumps(scene_document()))
    sequence = open_sequence(tmp_path)
    assert sequence.scene["objects"] == {"1": "wall"}
    assert sequence.require("motion", "motion_next") is sequence
    for frame in sequence:
        assert torch.allclose(frame.motion[0, :, 3, 3], torch.tensor([2.0, 0.0]), atol=1e-4)
        assert torch.allclose(frame.motion_next[0, :, 3, 3], torch.tensor([-2.0, 0.0]), atol=1e-4)


def without(document, *keys):
    return {k: v for k, v in document.items() if k not in keys}


def with_frame(document, **changes):
    return {**document, "frames": [document["frames"][0] | changes]}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda d: "{", "not valid JSON: Expecting property name"),
        (lambda d: [], "format is None, expected 'rtdenoise-scene-1'"),
        (lambda d: {**d, "format": "other"}, "format is 'other', expected 'rtdenoise-scene-1'"),
        (lambda d: {**d, "width": 99}, f"is for 99×{H} pixels, frame.0000.exr has {W}×{H}"),
        (lambda d: without(d, "objects"), "expected 'objects' (id -> name) and 'frames' (a list)"),
        (lambda d: {**d, "frames": [{}]}, "frames[0]: expected an object with an integer 'number'"),
        (lambda d: with_frame(d, object_to_world=None), "frames[0]: expected 'object_to_world' to map object ids to"),
        (
            lambda d: with_frame(d, object_to_world={"x": []}),
            "frames[0]: expected 'object_to_world' to map object ids to",
        ),
        (
            lambda d: with_frame(d, object_to_world={"1": [1]}),
            "frames[0]: expected 'object_to_world[1]' as 4×4 finite numb",
        ),
        (
            lambda d: with_frame(d, world_to_pixel=[[1, 2], [3]]),
            "frames[0]: expected 'world_to_pixel' as 4×4 finite numb",
        ),
        (lambda d: with_frame(d, world_to_pixel=np.eye(4).tolist()), "frames[0]: 'world_to_pixel' cannot be inverted"),
        (lambda d: with_frame(d, camera_origin=[0, float("nan"), 0]), "not valid JSON: NaN is not a JSON number"),
        (lambda d: json.dumps(d).replace("1.0", "1e999", 1), "frames[0]: expected 'world_to_pixel' as 4×4 finite"),
        (lambda d: with_frame(d, camera_origin=[0, 10**400, 0]), "frames[0]: expected 'camera_origin' as 3 finite"),
        (lambda d: with_frame(d, camera_origin=[0, True, 0]), "frames[0]: expected 'camera_origin' as 3 finite"),
        (lambda d: with_frame(d, camera_origin=["0", "1", "2"]), "frames[0]: expected 'camera_origin' as 3 finite"),
        (lambda d: with_frame(d, camera_origin={}), "frames[0]: expected 'camera_origin' as 3 finite numbers"),
        (lambda d: with_frame(d, number=True), "frames[0]: expected an object with an integer 'number'"),
        (lambda d: with_frame(d, number=10**30), "frames[0]: expected an object with an integer 'number'"),
        (lambda d: with_frame(d, shot=[1]), "frames[0]: shot is [1], expected an integer"),
        (lambda d: with_frame(d, object_to_world={"9" * 5000: []}), "frames[0]: expected 'object_to_world' to map"),
        (lambda d: with_frame(d, object_to_world={"1": [[1e308] * 4] * 4}), "frames[0]: 'object_to_world[1]' cannot"),
        (lambda d: {**d, "frames": d["frames"] * 2}, "frames[5]: number -1 is there twice"),
        (lambda d: {**d, "frames": d["frames"][:1]}, "no entry for frame 0, which frame.0000.exr is; render the s"),
        (lambda d: {**d, "objects": {"wall": "1"}}, "expected 'objects' (id -> name) and 'frames' (a list)"),
        (lambda d: {**d, "width": 10**3000}, "is for 1000000000"),
        (lambda d: {**d, "width": [[[[[[[[9]]]]]]]]}, "is for [[[[[[[...]]]]]]]×"),
        (lambda d: "[" * 100_000, "not valid JSON: nested too deeply"),
        (lambda d: '{"width": ' + "9" * 5000 + "}", "not valid JSON: Exceeds the limit"),
    ],
)
def test_a_scene_that_does_not_fit(tmp_path, change, expected):
    folder = write_native(tmp_path / "s", range(1))
    layers = {"color": np.ones((H, W, 3)), "position": np.ones((H, W, 3)), "id": np.ones((H, W, 1))}
    write_layers(folder / "frame.0000.exr", layers)  # without motion: the scene is needed
    changed = change(scene_document())
    (folder / "scene.json").write_text(changed if isinstance(changed, str) else json.dumps(changed))
    assert message(open_sequence, folder).startswith(f"{folder / 'scene.json'}: {expected}")


# --- places that are no ordinary files --------------------------------------------------------------------------------


def test_a_gap_of_billions_of_frames(tmp_path):
    folder = write_native(tmp_path / "s", [0, 9_999_999_999])
    assert open_sequence(folder, allow_gaps=True).gaps == ((1, 9_999_999_998),)
    assert "missing: 1 to 9999999998; render" in message(open_sequence, folder)


@pytest.mark.parametrize("name", ["frame.0001.exr", "scene.json"])
def test_a_pipe_is_not_waited_for(tmp_path, name):
    folder = write_native(tmp_path / "s", range(1))
    os.mkfifo(folder / name)
    assert message(open_sequence, folder) == f"{folder / name}: cannot be read: not a regular file"


def test_a_device_is_not_read(tmp_path):
    folder = write_native(tmp_path / "s", range(1))
    (folder / "frame.0001.exr").symlink_to("/dev/zero")
    assert message(open_sequence, folder) == f"{folder / 'frame.0001.exr'}: cannot be read: not a regular file"
    os.mkfifo(tmp_path / "my.toml")
    assert "my.toml: cannot be read: not a regular file" in message(
        open_sequence, folder, preset=str(tmp_path / "my.toml")
    )
    os.mkfifo(tmp_path / "frame.0001.zip")
    assert "frame.0001.zip: " in message(open_sequence, tmp_path, preset="noisebase")


def test_control_characters_in_names_are_escaped(tmp_path):
    folder = write_native(tmp_path / "s\n\x1b[31m", [1, 3])
    assert "s\\n\\x1b[31m/frame.0001.exr: the next frame is 3" in message(open_sequence, folder)


@pytest.mark.parametrize(
    "name",
    ["shot.{:04d}_v02.exr", "beauty.{:04d}.denoise.exr", "frame_{:04d}_v003.exr", "f{}v2.exr", "v1_{:02d}.V12.exr",
     "shot_{:04d}_64spp.exr", "shot.{}.4spp.v02.exr", "shot_{}_4k.exr", "shot.{:04d}.ap1.exr", "s1_{}_1920x1080.exr",
     "shot_{}_cam2_v01.exr", "Shot{}_4k.exr"],
)  # fmt: skip
def test_a_version_or_another_word_is_no_frame_number(tmp_path, name):
    folder = write_native(tmp_path / "s", [9, 10, 12], name=name)
    assert "the next frame is 12, missing: 11" in message(open_sequence, folder)
    found = open_sequence(folder, allow_gaps=True)
    assert (found.numbers, found.gaps) == ((9, 10, 12), ((11, 11),))
    assert found.names == tuple(name.format(number) for number in found.numbers)


def test_versions_of_one_frame_and_versions_alone(tmp_path):
    folder = write_native(tmp_path / "s", [2, 3], name="shot.0001_v{:02d}.exr")
    assert "frame number 1 is there twice" in message(open_sequence, folder)
    assert open_sequence(write_native(tmp_path / "versions", [2, 3], name="look_v{:02d}.exr")).numbers == (2, 3)
    assert open_sequence(write_native(tmp_path / "samples", [2, 3], name="look_{}spp.exr")).numbers == (2, 3)


def test_words_with_digits(tmp_path):
    """One file, numbers of words alone, and lights of one frame, which are no sequence."""
    assert open_sequence(write_native(tmp_path / "one", [12], name="shot_{}_4k.exr")).numbers == (12,)
    assert open_sequence(write_native(tmp_path / "words", [2, 3], name="cam1_look{}_4k.exr")).numbers == (2, 3)
    lights = write_native(tmp_path / "lights", [1, 2], name="light{}.0012.exr")
    assert "frame number 12 is there twice" in message(open_sequence, lights)


def test_numbers_before_zero(tmp_path):
    shot = write_native(tmp_path / "shot", [1, 2, 3, 4], name="v2.{}.exr")
    for old, new in (("v2.1", "v2.-2"), ("v2.2", "v2.-1"), ("v2.3", "v2.0"), ("v2.4", "v2.1")):
        (shot / f"{old}.exr").rename(shot / f"{new}.exr")
    assert open_sequence(shot).numbers == (-2, -1, 0, 1)
    assert open_sequence(write_native(tmp_path / "hyphens", [1, 2], name="shot-{:04d}.exr")).numbers == (1, 2)


@pytest.mark.parametrize("part", ["color", "rgba", "RGBA", "beauty"])
def test_the_beauty_in_a_part_of_its_own(tmp_path, part):
    planes = {name: np.full((H, W), i, np.float32) for i, name in enumerate("RGB")}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    contents = {part: planes, "depth": {"Z": planes["R"]}}
    parts = [OpenEXR.Part(dict(header), pixels, name) for name, pixels in contents.items()]
    OpenEXR.File(parts).write(str(tmp_path / "1.exr"))
    frame = open_sequence(tmp_path / "1.exr")[0]
    assert frame.depth is not None and frame.radiance[0, :, 0, 0].tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("keep", "kept"),
    [
        (("albedo", "depth"), {"ViewLayer.Denoising Albedo.G", "ViewLayer.Depth.Z"}),
        (("Mist",), {"ViewLayer.Mist.Z"}),
        (("ViewLayer.Mist", "ViewLayer.Depth.Z"), {"ViewLayer.Mist.Z", "ViewLayer.Depth.Z"}),
    ],
)
def test_what_is_kept_goes_by_the_layouts_names_and_by_the_files(tmp_path, keep, kept):
    write_cycles(tmp_path / "1.exr")
    sequence = open_sequence(tmp_path / "1.exr")
    (tmp_path / "out").mkdir()
    write_frame(tmp_path / "out", sequence, 0, sequence.read(0), np.ones((1, 3, H, W), np.float32), keep=keep)
    assert kept < set(read_header(tmp_path / "out" / "1.exr").channels)
    assert not any("Noisy" in name for name in read_header(tmp_path / "out" / "1.exr").channels)
