"""Training clips: required and optional layers, and their types."""

from __future__ import annotations

import json

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from rtdenoise.data.clip_file import FEATURES, OPTIONAL, RADIANCE, bytes_per_clip, clip_path, write_clip
from rtdenoise.data.clip_file import read_layers as read_clip
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.exr import read_header, write_layers
from rtdenoise.data.layers import LAYERS
from rtdenoise.errors import InputError

H, W, COUNT = 6, 8, 3


def make_frames(*optional):
    """Frames of random values that half precision holds exactly."""
    rng = np.random.default_rng(0)
    names = (*RADIANCE, *FEATURES, *optional)
    return [
        {name: rng.integers(0, 200, (H, W, LAYERS[name].channels)).astype(np.float32) for name in names}
        for _ in range(COUNT)
    ]


def write(folder, frames, *optional):
    write_clip(clip_path(folder, 0), frames, {"seed": 1}, optional)
    return ClipDataset(folder)


def images(frame, name):
    return np.moveaxis(frame[name], 2, 0)[None]


def test_every_layer_is_named_once():
    assert set(RADIANCE) | set(FEATURES) | set(OPTIONAL) == LAYERS.keys()
    assert len(RADIANCE) + len(FEATURES) + len(OPTIONAL) == len(LAYERS)


def test_exr_files_and_clips_use_the_same_names(tmp_path):
    frames = make_frames("position")
    write_layers(tmp_path / "1.exr", frames[0])
    channels = {name.rpartition(".")[0] or "color" for name in read_header(tmp_path / "1.exr").channels}
    write(tmp_path, frames, "position")
    assert channels == load_file(clip_path(tmp_path, 0)).keys()


def test_position_is_loaded_when_asked_for(tmp_path):
    frames = make_frames("position")
    clips = write(tmp_path, frames, "position")
    assert clips.load(0)[0].position is None
    for frame, written in zip(clips.load(0, layers=["position"]), frames, strict=True):
        np.testing.assert_array_equal(frame.position, images(written, "position"))


def test_a_layer_that_the_clip_lacks(tmp_path):
    clips = write(tmp_path, make_frames())
    with pytest.raises(InputError, match=r"clip_000000.safetensors: has no layer 'position'; it has albedo, color"):
        clips.load(0, layers=["position"])


def test_layers_are_written_only_when_named(tmp_path):
    frames = make_frames("position")
    write(tmp_path, frames)
    assert load_file(clip_path(tmp_path, 0)).keys() == {*RADIANCE, *FEATURES}
    with pytest.raises(ValueError, match="unknown layer colour; optional layers are position, direct, samples"):
        write(tmp_path, frames, "colour")


@pytest.mark.parametrize("optional", [(), ("position", "samples")])
def test_the_size_of_a_clip_is_known_beforehand(tmp_path, optional):
    write(tmp_path, make_frames(*optional), *optional)
    stored = load_file(clip_path(tmp_path, 0))
    assert sum(array.nbytes for array in stored.values()) == bytes_per_clip((H, W), COUNT, optional)
    assert stored["color"].dtype == np.float16 and stored["id"].dtype == np.uint16


def test_large_values_of_optional_layers_are_scaled(tmp_path):
    frames = make_frames("large", "small")
    frames[1]["large"][2, 3] = 1e6
    frames[1]["small"][2, 3] = 1e12  # beyond what scaling brings into range
    frames[1]["color"][2, 3] = 1e6
    write(tmp_path, frames, "large", "small")
    assert np.isfinite(load_file(clip_path(tmp_path, 0))["large"]).all()
    read = read_clip(clip_path(tmp_path, 0))
    np.testing.assert_allclose(read["large"][1], images(frames[1], "large")[0], rtol=2**-11, atol=1e-5)
    assert (read["small"][1, :, 2, 3] == 65504 * 1024).all()
    assert (read["color"][1, :, 2, 3] == 65504).all()


def test_samples_and_components_become_fields_of_the_frame(tmp_path):
    optional = ("samples", "large", "small")
    frames = make_frames(*optional)
    frames[0]["large"][0, 0] = 1e5
    clips = write(tmp_path, frames, *optional)
    for signal in ("color", "indirect"):
        for frame, written in zip(clips.load(0, signal=signal), frames, strict=True):
            np.testing.assert_array_equal(frame.samples, images(written, "samples"))
            if signal == "indirect":
                assert frame.components is None  # they make up the beauty
            else:
                stacked = np.concatenate([images(written, "large"), images(written, "small")], 1)
                np.testing.assert_allclose(frame.components, stacked, rtol=2**-10)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (None, "not a clip: its header has no JSON object 'clip'; delete it and render it again"),
        ({"clip": "[1]"}, "not a clip: its header has no JSON object 'clip'; delete it and render it again"),
        ({"clip": "["}, "not a clip: its header has no JSON object 'clip'; delete it and render it again"),
        ({"clip": "{}", "scales": "[" * 10_000}, "not a clip: its header has no JSON object 'scales'; delete it and"),
        ({"clip": "{}", "scales": '{"color": 1e30}'}, "damaged: its scales are {'color': 1e+30}; delete it and render"),
        ({"clip": "{}", "scales": '{"color": "2"}'}, "damaged: its scales are {'color': '2'}; delete it and render it"),
        ({"clip": "{}"}, "has no layer 'color'; it has x"),
    ],
)
def test_files_that_are_no_clips(tmp_path, header, expected):
    path = clip_path(tmp_path, 0)
    tensors = {"x": np.zeros(1)}
    if header and "scales" in header:
        write(tmp_path, make_frames())
        tensors = load_file(path)
    save_file(tensors, path, metadata=header)
    with pytest.raises(InputError) as caught:
        ClipDataset(tmp_path).facts(0)
        ClipDataset(tmp_path).load(0)
    assert str(caught.value).startswith(f"{path}: {expected}")


@pytest.mark.parametrize("facts", [
    {"lead_in": None}, {"lead_in": -3}, {"lead_in": 1.5}, {"lead_in": 99}, {"spp": "x"}, {"spp": 0}, {"spp": []},
])  # fmt: skip
def test_facts_that_are_no_counts_are_one_line(tmp_path, facts):
    write_clip(clip_path(tmp_path, 0), make_frames(), facts)
    with pytest.raises(InputError, match=r"clip_000000\.safetensors: (damaged: lead_in is|expected at least)"):
        ClipDataset(tmp_path).load(0)


@pytest.mark.parametrize("facts", [{}, {"generator": 3}, {"kind": "scene file", "seed": 1}])
def test_facts_that_do_not_name_the_scene_are_one_line(tmp_path, facts):
    write_clip(path := clip_path(tmp_path, 0), make_frames(), {})
    save_file(load_file(path), path, {"clip": json.dumps(facts)})
    with pytest.raises(InputError, match=r"clip_000000\.safetensors: its facts lack '(seed|source)'"):
        ClipDataset(tmp_path).scenes()


def test_every_composition_of_assets_is_a_scene(tmp_path):
    for index, (scene, take) in enumerate([(0, 0), (0, 1), (1, 0)]):
        facts = {"kind": "composed", "scene": scene, "take": take, "seed": 2}
        write_clip(clip_path(tmp_path, index), make_frames(), facts)
    assert ClipDataset(tmp_path).scenes() == {"composition 0, seed 2", "composition 1, seed 2"}


def test_a_scene_file_is_one_scene_whatever_moves_in_it(tmp_path):
    for index, kind in enumerate(["scene file", "calm scene file"]):
        facts = {"kind": kind, "source": "kitchen", "generator": 3, "seed": 2}
        write_clip(clip_path(tmp_path, index), make_frames(), facts)
    assert ClipDataset(tmp_path).scenes() == {"kitchen"}
