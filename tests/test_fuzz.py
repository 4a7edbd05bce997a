"""Files that are damaged in any way are refused with one line, or read; nothing else."""

import json
import struct

import fuzz_targets
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError

BOUNDED = settings(max_examples=150, deadline=None, derandomize=True,
                   suppress_health_check=[HealthCheck.function_scoped_fixture])  # fmt: skip


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    """The bytes of small files: one part, and several as Cycles writes them."""
    import OpenEXR

    folder = tmp_path_factory.mktemp("intact")
    image = np.random.default_rng(0).random((9, 7, 3), np.float32)
    for compression in ("zip", "none", "piz"):
        write_layers(folder / f"{compression}.exr", {"color": image, "albedo": image, "depth": image[..., :1]},
                     compression=compression)  # fmt: skip
    parts = [OpenEXR.Part({}, {"RGB": image}, "VL.Combined"), OpenEXR.Part({}, {"Z": image[..., 0].copy()}, "VL.Depth")]
    OpenEXR.File(parts).write(str(folder / "multi.exr"))
    return [path.read_bytes() for path in sorted(folder.iterdir())]


def survives(path, data):
    """Read all there is; InputError of one line that names the file is the only way out."""
    path.write_bytes(data)
    for read in (lambda: read_channels(path, list(read_header(path).channels)), lambda: open_sequence(path)[0]):
        try:
            read()
        except InputError as error:
            assert str(path) in str(error) and "\n" not in str(error), error


@BOUNDED
@given(data=st.data())
def test_truncated_anywhere(tmp_path, intact, data):
    whole = data.draw(st.sampled_from(intact))
    survives(tmp_path / "frame.0001.exr", whole[: data.draw(st.integers(0, len(whole) - 1))])


@BOUNDED
@given(data=st.data())
def test_bytes_changed_anywhere_in_the_header(tmp_path, intact, data):
    """The first 400 bytes hold the header and the chunk table."""
    damaged = bytearray(data.draw(st.sampled_from(intact)))
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, 399))] = data.draw(st.integers(0, 255))
    survives(tmp_path / "frame.0001.exr", bytes(damaged))


@BOUNDED
@given(data=st.data())
def test_numbers_of_the_header_replaced_by_extreme_ones(tmp_path, intact, data):
    extreme = st.sampled_from([0, 1, -1, 2**31 - 1, -(2**31), 65536, 2**16 - 1, 0x7F7F7F7F])
    damaged = bytearray(data.draw(st.sampled_from(intact)))
    at = data.draw(st.integers(4, 396))
    damaged[at : at + 4] = struct.pack("<i", data.draw(extreme))
    survives(tmp_path / "frame.0001.exr", bytes(damaged))


@BOUNDED
@given(data=st.data())
def test_bytes_changed_anywhere_in_the_pixels(tmp_path, intact, data):
    damaged = bytearray(data.draw(st.sampled_from(intact)))
    for _ in range(data.draw(st.integers(1, 8))):
        damaged[data.draw(st.integers(400, len(damaged) - 1))] ^= data.draw(st.integers(1, 255))
    survives(tmp_path / "frame.0001.exr", bytes(damaged))


def scene():
    camera = {"world_to_pixel": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1], [0, 0, 1, 0]], "camera_origin": [0, 0, 0]}
    frames = [{"number": n, "shot": 0, "object_to_world": {"1": np.eye(4).tolist()}, **camera} for n in range(3)]
    return {"format": "rtdenoise-scene-1", "width": 7, "height": 9, "objects": {"1": "wall"}, "frames": frames}


def places(value, path=()):
    """The path of every value in nested lists and dicts."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield from places(item, (*path, key))


ODD = st.one_of(
    st.none(), st.booleans(), st.text(max_size=3), st.integers(), st.floats(), st.just(10**400),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=1), st.lists(st.integers(), max_size=5),
)  # fmt: skip


@BOUNDED
@given(data=st.data())
def test_a_scene_with_odd_values_anywhere(tmp_path, data):
    """It is refused in one line, or every layer can be computed from it."""
    image = np.ones((9, 7, 3), np.float32)
    write_layers(tmp_path / "1.exr", {"color": image, "position": image, "id": image[..., :1]})
    document = scene()
    for _ in range(data.draw(st.integers(1, 2))):
        *path, last = data.draw(st.sampled_from(sorted(places(document), key=repr))) or ("format",)
        parent = document
        for key in path:
            parent = parent[key]
        parent[last] = data.draw(ODD)
    (tmp_path / "scene.json").write_text(json.dumps(document))
    try:
        frame = open_sequence(tmp_path)[0]
    except InputError as error:
        assert "scene.json" in str(error) and "\n" not in str(error)
    else:
        assert frame.depth is not None


@BOUNDED
@given(noise=st.binary(max_size=600), magic=st.booleans())
def test_noise(tmp_path, noise, magic):
    survives(tmp_path / "frame.0001.exr", (b"\x76\x2f\x31\x01\x02\0\0\0" if magic else b"") + noise)


@pytest.mark.parametrize("kind", fuzz_targets.TARGETS)
def test_the_fuzzers_inputs_are_survived(kind):
    """Inputs that tools/fuzz.py found, each of which reaches further lines; findings of before among them."""
    inputs = sorted((fuzz_targets.CORPUS / kind).iterdir())
    assert inputs
    for path in inputs:
        fuzz_targets.TARGETS[kind](path.read_bytes())


@pytest.mark.parametrize("kind", fuzz_targets.TARGETS)
def test_the_fuzzer_begins_with_files_that_are_read(kind, monkeypatch):
    refused, found = fuzz_targets.refused, []
    monkeypatch.setattr(fuzz_targets, "refused", lambda read: found.append(refused(read)) or found[-1])
    for seed in fuzz_targets.seeds(kind):
        fuzz_targets.TARGETS[kind](seed)
    assert found and not any(found)
