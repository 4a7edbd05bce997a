"""Noisebase's zip files: values as its own loaders give them, both formats, and refusals of broken files."""

import json
import sys
import zipfile
from pathlib import Path

import archives
import numpy as np
import pytest
from synthetic import save_tiny

from rtdenoise.data.exr import read_channels
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError
from rtdenoise.frame import OFF_SCREEN
from rtdenoise.run.denoise import Options, denoise
from rtdenoise.run.inspect import inspect

STORED = Path(__file__).parent / "data" / "noisebase"
SIZE = (48, 64)


@pytest.fixture(scope="module")
def shot(tmp_path_factory):
    """A folder with a file for each of 4 frames."""
    folder = tmp_path_factory.mktemp("noisebase")
    for number in range(4):
        archives.write(folder / f"frame{number:04d}.zip", archives.frame(number, SIZE))
    return folder


def message(function, *args, **kwargs):
    with pytest.raises(InputError) as caught:
        function(*args, **kwargs)
    return str(caught.value)


@pytest.mark.parametrize(
    ("kind", "source", "rows"),
    [("test", "frame*.zip", slice(28, -28)), ("train", "scene0000.zip", slice(None))],  # its test loader drops 28 rows
)
def test_values_are_those_of_noisebase(kind, source, rows):
    loaded = np.load(STORED / "loaded.npz").items()
    expected = {name.partition(".")[2]: array for name, array in loaded if name.startswith(kind)}
    sequence = open_sequence(str(STORED / source), preset="noisebase:2", layers=("reference",))
    read = {layer: tensor[0, :, rows].numpy() for layer, tensor in sequence[1].layers()}
    hit = read["depth"] > 0
    assert 0.2 < hit.mean() < 0.9

    for layer, name in (("radiance", "color"), ("albedo", "diffuse"), ("normal", "w_normal")):
        np.testing.assert_allclose(read[layer], expected[name].mean(-1), rtol=1e-6)
    np.testing.assert_array_equal(read["reference"], expected["reference"])
    distance = 1 / np.expm1(expected["depth"][..., 0])  # it stores log(1 + 1/distance)
    np.testing.assert_allclose(read["depth"][hit], distance[hit], rtol=1e-5)
    motion = expected["motion"][::-1, ..., 0]  # it counts rows first
    motion = motion + expected.get("shift", np.zeros(2))[::-1, None, None]  # and leaves the crop's own motion out
    np.testing.assert_allclose(np.where(hit, read["motion"] - motion, 0), 0, atol=1e-4)
    assert np.abs(motion[:, hit[0]]).max() > 2


def test_frames_of_a_folder(shot):
    sequence = open_sequence(shot)
    assert (sequence.layout.name, sequence.numbers, sequence.size) == ("noisebase", (0, 1, 2, 3), SIZE)
    assert sequence.names[3] == "frame0003.exr" and not sequence.demodulated
    frame = sequence[2]
    sky = frame.depth == 0
    assert 0.1 < sky.float().mean() < 0.5
    # Sky is at infinity: it moves with the turning camera alone, by about as many pixels everywhere.
    moved = frame.motion[:, :1][sky]
    assert 0.2 < moved.abs().mean() < 3 and moved.std() < 0.2
    assert (sequence[0].motion == OFF_SCREEN).all()
    assert (open_sequence(str(shot / "frame000[23].zip"))[0].motion == OFF_SCREEN).all()  # no camera to compare with
    found = inspect(shot)
    assert found.convention.status == "ok"
    assert found.dual_motion.startswith("approximate") and "frame before only" in found.missing["motion_next"]


def test_more_samples_mean_less_noise_and_the_same_geometry(shot):
    one, eight = open_sequence(shot, layers=("reference",))[1], open_sequence(shot, preset="noisebase:8")[1]
    error = [(frame.radiance - one.reference).square().mean().item() for frame in (one, eight)]
    assert error[1] < error[0] / 5
    assert (one.motion == eight.motion).all() and (one.depth == eight.depth).all()


def test_a_sequence_in_one_file(tmp_path):
    offsets = [(520, 940), (521, 944), (522, 948)]
    frames = [archives.frame(i, (1080, 1920), (40, 48), offsets[i]) for i in range(3)]
    clip = archives.write(tmp_path / "scene0007.zip", frames)
    sequence = open_sequence(clip)
    assert (sequence.numbers, sequence.size) == ((0, 1, 2), (40, 48))
    assert sequence.names == ("scene0007.0000.exr", "scene0007.0001.exr", "scene0007.0002.exr")
    assert inspect(clip).convention.status == "ok"
    archives.write(tmp_path / "scene0008.zip", frames)
    assert message(open_sequence, tmp_path).endswith(
        "is a sequence of 3 frames, and so are the other 1 files; give one of them"
    )


def test_denoised_into_exr_files(shot, tmp_path):
    options = Options(model=str(save_tiny(tmp_path)), keep=("depth",), device="cpu")
    assert denoise(str(shot), tmp_path / "out", options).written == 4
    assert read_channels(tmp_path / "out" / "frame0003.exr", ["R", "depth.Z"])["R"].shape == SIZE
    assert denoise(str(shot), tmp_path / "out", options).skipped == 4
    assert "layout 'source' copies EXR files" in message(
        denoise, str(shot), tmp_path / "like", Options(model=options.model, layout="source")
    )


@pytest.mark.parametrize(
    "damage", [{"shape": None}, {"chunks": [0, 0, 0, 0]}, {"fill_value": "abc"}, {"compressor": {"id": "lzma"}}, []],
    ids=str,
)  # fmt: skip
def test_damaged_descriptions_of_arrays_are_one_line(shot, tmp_path, damage):
    path = tmp_path / "frame0000.zip"
    with zipfile.ZipFile(shot / "frame0000.zip") as whole, zipfile.ZipFile(path, "w") as damaged:
        for name in whole.namelist():
            content = whole.read(name)
            if name == "color/.zarray":
                content = json.dumps(json.loads(content) | damage if damage else damage)
            damaged.writestr(name, content)
    told = message(lambda: open_sequence(path)[0])
    assert told.startswith(f"{path}: not a readable zip file of Zarr arrays") and "\n" not in told


def test_bad_files(shot, tmp_path, monkeypatch):
    assert "no signal 'indirect'" in message(open_sequence, shot, signal="indirect")
    assert message(open_sequence, shot, preset="noisebase:all").startswith("preset 'noisebase:all': expected")
    for count in ("00", 5000 * "9"):
        told = message(open_sequence, shot, preset=f"noisebase:{count}")
        assert "expected noisebase:N" in told and len(told) < 120
    assert "has 8 samples a pixel, 9 were asked for (--preset noisebase:8" in message(
        open_sequence, shot, preset="noisebase:9"
    )
    path = tmp_path / "frame0000.zip"
    path.write_bytes((shot / "frame0000.zip").read_bytes()[:5000])
    assert message(open_sequence, path).startswith(f"{path}: not a readable zip file of Zarr arrays")
    with zipfile.ZipFile(path, "w") as other:
        other.writestr("notes.txt", "not arrays")
    assert message(open_sequence, path).startswith(f"{path}: not a readable zip file of Zarr arrays")
    arrays = archives.frame(0, SIZE)
    archives.write(path, {name: array for name, array in arrays.items() if name != "diffuse"})
    assert message(open_sequence, path).startswith(f"{path}: no array 'diffuse'; it has camera_position")
    archives.write(path, arrays | {"motion": arrays["motion"][:, 1:]})
    assert message(open_sequence, path).startswith(f"{path}: array 'motion' is (3, 47, 64, 8), expected (3, 48, 64, 8)")
    monkeypatch.setitem(sys.modules, "zarr", None)
    assert "pip install 'rtdenoise[noisebase]'" in message(open_sequence, shot)
