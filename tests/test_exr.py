"""Reading and writing OpenEXR: values survive, and broken files are refused."""

from __future__ import annotations

import os
import resource
import struct

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from synthetic import message

from rtdenoise.data.exr import read_attributes, read_channels, read_header, write_layers, write_like
from rtdenoise.data.opening import open_sequence
from rtdenoise.errors import InputError

H, W = 37, 23


def noise(*shape, seed=0):
    return np.random.default_rng(seed).random(shape, dtype=np.float32)


def write_parts(path, parts, compression=OpenEXR.ZIP_COMPRESSION):
    """A multi-part file: part name -> {channel as stored -> [H, W]}."""
    window = (np.zeros(2, np.int32), np.array([W - 1, H - 1], np.int32))
    header = {"compression": compression, "type": OpenEXR.scanlineimage, "displayWindow": window}
    made = [OpenEXR.Part(dict(header), dict(channels), name) for name, channels in parts.items()]  # it alters its dicts
    OpenEXR.File(made).write(str(path))


def read_all(path):
    return read_channels(path, list(read_header(path).channels))


# --- round trips ------------------------------------------------------------------------------------------------------


def test_layers_get_their_native_names_and_types(tmp_path):
    sizes = {"color": 3, "indirect": 3, "albedo": 3, "normal": 3, "position": 3, "motion": 2, "motion_next": 2,
             "depth": 1, "id": 1}  # fmt: skip
    write_layers(tmp_path / "a.exr", {layer: noise(H, W, c) for layer, c in sizes.items()})
    header = read_header(tmp_path / "a.exr")
    assert (header.width, header.height) == (W, H)
    half, exact = dict.fromkeys, dict.fromkeys
    assert header.channels == {
        **half(["R", "G", "B", "indirect.R", "indirect.G", "indirect.B"], "half"),
        **half(["albedo.R", "albedo.G", "albedo.B", "normal.X", "normal.Y", "normal.Z"], "half"),
        **exact(["position.X", "position.Y", "position.Z", "motion.X", "motion.Y"], "float"),
        **exact(["motion_next.X", "motion_next.Y", "depth.Z"], "float"),
        "id.I": "uint",
    }
    assert header.summary.startswith("R,G,B, albedo.{R,G,B}, depth.Z, id.I")


@pytest.mark.parametrize("compression", ["none", "rle", "zips", "zip", "piz"])
def test_lossless_compressions_return_the_stored_values(tmp_path, compression):
    color, depth = noise(H, W, 3), noise(H, W, 1, seed=1) * 1e6
    write_layers(tmp_path / "a.exr", {"color": color, "depth": depth}, compression=compression)
    read = read_channels(tmp_path / "a.exr", ["G", "depth.Z"])
    assert list(read) == ["G", "depth.Z"] and all(plane.dtype == np.float32 for plane in read.values())
    np.testing.assert_array_equal(read["G"], color[:, :, 1].astype(np.float16).astype(np.float32))
    np.testing.assert_array_equal(read["depth.Z"], depth[:, :, 0])


def test_types_can_be_chosen(tmp_path):
    color = noise(H, W, 3)
    write_layers(tmp_path / "a.exr", {"color": color}, dtypes={"color": "float"})
    np.testing.assert_array_equal(read_channels(tmp_path / "a.exr", ["R"])["R"], color[:, :, 0])


def test_half_clamps_what_it_cannot_hold_and_keeps_nan(tmp_path):
    color = np.zeros((1, 4, 3), np.float32)
    color[0, :, 0] = [1e9, -np.inf, np.nan, 65504]
    write_layers(tmp_path / "a.exr", {"color": color})
    np.testing.assert_array_equal(read_channels(tmp_path / "a.exr", ["R"])["R"], [[65504, -65504, np.nan, 65504]])


def test_ids_are_exact_integers(tmp_path):
    ids = np.array([[0, 1, 2**24 - 1], [2.0000001, 2.9999999, np.nan]])[:, :, None]
    write_layers(tmp_path / "a.exr", {"id": ids})
    np.testing.assert_array_equal(read_channels(tmp_path / "a.exr", ["id.I"])["id.I"], [[0, 1, 2**24 - 1], [2, 3, 0]])


def test_complete_channel_names_are_kept(tmp_path):
    write_layers(tmp_path / "a.exr", {"ViewLayer.Combined.R": noise(H, W), "V": noise(H, W)}, dtypes={"V": "float"})
    assert read_header(tmp_path / "a.exr").channels == {"V": "float", "ViewLayer.Combined.R": "half"}


def test_one_pixel_and_non_contiguous_images(tmp_path):
    write_layers(tmp_path / "a.exr", {"depth": np.full((1, 1, 1), 7.0)})
    assert read_all(tmp_path / "a.exr")["depth.Z"].tolist() == [[7.0]]
    turned = noise(W, H, 3).transpose(1, 0, 2)[::-1]
    write_layers(tmp_path / "b.exr", {"position": turned})
    np.testing.assert_array_equal(read_all(tmp_path / "b.exr")["position.Y"], turned[:, :, 1])


def test_attributes_are_written(tmp_path):
    write_layers(tmp_path / "a.exr", {"depth": noise(H, W, 1)}, attributes={"comments": "of this project"})
    assert OpenEXR.File(str(tmp_path / "a.exr"), header_only=True).header()["comments"] == "of this project"


def test_a_layer_of_the_wrong_shape_is_a_programming_error(tmp_path):
    with pytest.raises(ValueError, match=r"'motion': expected \[H, W, 2\], got \(37, 23, 3\)"):
        write_layers(tmp_path / "a.exr", {"motion": noise(H, W, 3)})
    with pytest.raises(ValueError, match="expected layers of one size"):
        write_layers(tmp_path / "a.exr", {"depth": noise(H, W, 1), "color": noise(H, H, 3)})


# --- files of other programs ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stored", ["Z", "Depth.Z", "ViewLayer.Depth.Z"])
def test_multi_part_channels_are_qualified_with_their_part(tmp_path, stored):
    rgb = {f"ViewLayer.Combined.{c}": noise(H, W, seed=i) for i, c in enumerate("RGB")}
    depth = noise(H, W, seed=3)
    write_parts(tmp_path / "a.exr", {"ViewLayer.Combined": rgb, "ViewLayer.Depth": {stored: depth}})
    header = read_header(tmp_path / "a.exr")
    assert set(header.channels) == {*rgb, "ViewLayer.Depth.Z"} and set(header.channels.values()) == {"float"}
    read = read_channels(tmp_path / "a.exr", ["ViewLayer.Depth.Z", "ViewLayer.Combined.G"])
    np.testing.assert_array_equal(read["ViewLayer.Depth.Z"], depth)
    np.testing.assert_array_equal(read["ViewLayer.Combined.G"], rgb["ViewLayer.Combined.G"])


@pytest.mark.parametrize("compression", ["NO", "ZIPS", "ZIP", "PIZ"])
def test_every_part_comes_back(tmp_path, compression):
    parts = {f"L.P{i}": {"X": noise(H, W, seed=i), "Y": noise(H, W, seed=-i % 9 + 9)} for i in range(5)}
    write_parts(tmp_path / "a.exr", parts, compression=getattr(OpenEXR, f"{compression}_COMPRESSION"))
    read = read_all(tmp_path / "a.exr")
    for part, channels in parts.items():
        for name, plane in channels.items():
            np.testing.assert_array_equal(read[f"{part}.{name}"], plane)


def test_of_several_views_the_one_without_a_prefix_is_read(tmp_path):
    planes = {f"{layer}{view}{c}": np.full((4, 4), len(view)) for layer in ("", "albedo.") for view in ("", "left.")
              for c in "RGB"}  # fmt: skip
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "multiView": ["right", "left"]}
    channels = {name: plane.astype(np.float32) for name, plane in planes.items()}
    (tmp_path / "one").mkdir()
    OpenEXR.File([OpenEXR.Part(header, channels)]).write(str(tmp_path / "one" / "1.exr"))
    frame = open_sequence(tmp_path / "one", layers=()).read(0)
    assert not frame.radiance.any() and not frame.albedo.any()
    parts = [
        OpenEXR.Part(header | {"view": view}, {f"albedo.{c}": np.zeros((4, 4), np.float32) for c in "RGB"}, view)
        for view in ("left", "right")
    ]
    OpenEXR.File(parts).write(str(tmp_path / "2.exr"))
    with pytest.raises(InputError, match=r"2.exr: holds several views \(left, right\) with channels of one name, such"):
        read_header(tmp_path / "2.exr")


def test_tiled_parts(tmp_path):
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription(), "compression": OpenEXR.ZIP_COMPRESSION}
    header["tiles"].xSize = header["tiles"].ySize = 16
    planes = [noise(H, W, seed=i) for i in range(2)]
    OpenEXR.File([OpenEXR.Part(dict(header), {"X": p}, f"L.P{i}") for i, p in enumerate(planes)]).write(
        str(tmp_path / "m.exr")
    )
    np.testing.assert_array_equal(read_channels(tmp_path / "m.exr", ["L.P1.X"])["L.P1.X"], planes[1])
    OpenEXR.File(header, {"X": planes[0]}).write(str(tmp_path / "s.exr"))
    np.testing.assert_array_equal(read_channels(tmp_path / "s.exr", ["X"])["X"], planes[0])
    assert all(read_attributes(tmp_path / name)["screenWindowWidth"] == 1 for name in ("m.exr", "s.exr"))


@pytest.mark.parametrize("order", ["INCREASING_Y", "DECREASING_Y", "RANDOM_Y"])
def test_tiles_in_any_order_are_copied(tmp_path, order):
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription(), "lineOrder": getattr(OpenEXR, order)}
    header["tiles"].xSize = header["tiles"].ySize = 16
    kept, changed = noise(H, W), noise(H, W, seed=1)
    OpenEXR.File(header, {"X": kept, "Y": kept}).write(str(tmp_path / "tiles.exr"))
    write_like(tmp_path / "copy.exr", tmp_path / "tiles.exr", {"Y": changed})
    copied = read_all(tmp_path / "copy.exr")
    assert np.array_equal(copied["X"], kept) and np.array_equal(copied["Y"], changed)


def test_light_in_the_place_of_whole_numbers_is_not_rounded(tmp_path):
    whole, light = np.arange(H * W, dtype=np.uint32).reshape(H, W), noise(H, W)
    OpenEXR.File({}, {"R": whole, "id": whole}).write(str(tmp_path / "a.exr"))
    write_like(tmp_path / "b.exr", tmp_path / "a.exr", {"R": light})
    assert read_header(tmp_path / "b.exr").channels == {"R": "float", "id": "uint"}
    assert np.array_equal(read_all(tmp_path / "b.exr")["R"], light)


@pytest.mark.parametrize(("stored", "value"), [
    ("stringvector", b""), ("string", b"\xff"), ("mine", b"abc"), ("rational", struct.pack("<iI", 24, 0)),
])  # fmt: skip
def test_attributes_that_openexr_cannot_pass_on_do_no_harm(tmp_path, stored, value):
    write_layers(tmp_path / "a.exr", {"V": noise(4, 4)}, attributes={"odd": "x"})
    header, data = read_header(tmp_path / "a.exr"), (tmp_path / "a.exr").read_bytes()
    old = b"odd\0string\0" + struct.pack("<i", 1) + b"x"
    new = b"odd\0" + stored.encode() + b"\0" + struct.pack("<i", len(value)) + value
    end = 8 + len(header.parts[0].attributes) + 1
    offsets = header.parts[0].offsets + np.uint64(len(new) - len(old))
    (tmp_path / "a.exr").write_bytes(data[:end].replace(old, new) + offsets.tobytes() + data[end + offsets.nbytes :])
    write_layers(tmp_path / "b.exr", {"V": noise(4, 4)}, attributes=read_attributes(tmp_path / "a.exr"))
    if stored == "rational":
        assert "a.exr: damaged: the pixels cannot be decoded" in message(read_all, tmp_path / "a.exr")
    else:
        np.testing.assert_array_equal(read_all(tmp_path / "b.exr")["V"], read_all(tmp_path / "a.exr")["V"])
        write_like(tmp_path / "c.exr", tmp_path / "a.exr", {})
        np.testing.assert_array_equal(read_all(tmp_path / "c.exr")["V"], read_all(tmp_path / "a.exr")["V"])


def test_only_the_wanted_parts_are_decoded(tmp_path):
    """Damaged pixels of one part do not affect the reading of another."""
    flat = np.ones((H, W), np.float32)  # compresses; in pixels stored uncompressed damage goes unnoticed
    write_parts(tmp_path / "a.exr", {"L.A": {"X": noise(H, W)}, "L.B": {"X": flat}})
    data = bytearray((tmp_path / "a.exr").read_bytes())
    data[-10:] = b"\xff" * 10  # inside the last chunk, which belongs to the last part
    (tmp_path / "a.exr").write_bytes(data)
    np.testing.assert_array_equal(read_channels(tmp_path / "a.exr", ["L.A.X"])["L.A.X"], noise(H, W))
    assert "a.exr: damaged: the pixels cannot be decoded" in message(read_channels, tmp_path / "a.exr", ["L.B.X"])


def test_a_long_header_and_a_shifted_data_window(tmp_path):
    window = (np.array([100, -50], np.int32), np.array([100 + W - 1, -50 + H - 1], np.int32))
    header = {"comments": "x" * 300_000, "dataWindow": window, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"X": noise(H, W)}).write(str(tmp_path / "a.exr"))
    assert (read_header(tmp_path / "a.exr").width, read_header(tmp_path / "a.exr").height) == (W, H)
    np.testing.assert_array_equal(read_all(tmp_path / "a.exr")["X"], noise(H, W))


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"", "the file is empty (0 bytes)"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), r"not an OpenEXR file: starts with b'\x89PNG'"),
        (b"\x76\x2f", "truncated or damaged: the header does not end within the 2 bytes"),
        (b"\x76\x2f\x31\x01" + struct.pack("<I", 1), "version 1 of the format cannot be read"),
        (b"\x76\x2f\x31\x01" + struct.pack("<I", 2 | 0x800), "deep pixels cannot be read"),
        (b"\x76\x2f\x31\x01" + struct.pack("<I", 2) + b"\0", "damaged: the header has no 'channels'"),
    ],
)
def test_files_that_are_no_pictures(tmp_path, content, expected):
    (tmp_path / "a.exr").write_bytes(content)
    assert message(read_header, tmp_path / "a.exr").startswith(f"{tmp_path / 'a.exr'}: {expected}")


def test_files_that_cannot_be_opened(tmp_path):
    assert (
        message(read_header, tmp_path / "no.exr") == f"{tmp_path / 'no.exr'}: cannot be read: No such file or directory"
    )
    assert message(read_header, tmp_path) == f"{tmp_path}: cannot be read: Is a directory"


def test_a_missing_channel_names_what_there_is(tmp_path):
    write_layers(tmp_path / "a.exr", {"color": noise(H, W, 3)})
    found = message(read_channels, tmp_path / "a.exr", ["R", "depth.Z"])
    assert found == f"{tmp_path / 'a.exr'}: no channel 'depth.Z'; the file has R,G,B"


def test_parts_of_different_sizes(tmp_path):
    write_parts(tmp_path / "a.exr", {"L.A": {"X": noise(H, W)}, "L.B": {"X": noise(H, W + 1)}})
    assert read_channels(tmp_path / "a.exr", ["L.A.X"])["L.A.X"].shape == (H, W)
    assert f"part 'L.B' is {W + 1}×{H}, the first part {W}×{H}" in message(read_channels, tmp_path / "a.exr", ["L.B.X"])


def test_parts_of_one_size_at_different_places(tmp_path):
    corners = {"L.A": (0, 0), "L.B": (2, 1)}
    parts = [
        OpenEXR.Part({"dataWindow": ((x, y), (x + W - 1, y + H - 1))}, {"X": noise(H, W)}, name)
        for name, (x, y) in corners.items()
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    found = message(read_channels, tmp_path / "a.exr", ["L.B.X"])
    assert "the data window of part 'L.B' begins at (2, 1), that of the first part at (0, 0)" in found


def test_an_unfinished_file(tmp_path):
    """A renderer that is killed leaves zeros in the chunk table."""
    write_layers(tmp_path / "a.exr", {"color": noise(H, W, 3)})
    data = (tmp_path / "a.exr").read_bytes()
    first = min(read_header(tmp_path / "a.exr").parts[0].offsets)
    (tmp_path / "a.exr").write_bytes(data[: first - 8] + bytes(8) + data[first:])
    assert "truncated: chunk 2 was never written (an interrupted render?)" in message(read_header, tmp_path / "a.exr")


@pytest.fixture(scope="module")
def whole_files(tmp_path_factory):
    """A file with one part and one with three, as bytes, and a path to put cut ones at."""
    folder = tmp_path_factory.mktemp("cut")
    write_layers(folder / "one.exr", {"color": noise(H, W, 3), "depth": noise(H, W, 1)})
    write_parts(folder / "many.exr", {f"L.P{i}": {c: noise(H, W, seed=i) for c in "XY"} for i in range(3)})
    return [(folder / name).read_bytes() for name in ("one.exr", "many.exr")], folder / "cut.exr"


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(which=st.integers(0, 1), share=st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_found_out_from_its_header(whole_files, which, share, capfd):
    """Cut anywhere; and OpenEXR, which prints to the terminal when it fails, never gets to see it."""
    files, path = whole_files
    path.write_bytes(files[which][: int(share * len(files[which]))])
    found = message(read_header, path)
    assert found.startswith(f"{path}: ")
    assert any(word in found for word in ("truncated", "empty", "not an OpenEXR file"))
    assert capfd.readouterr() == ("", "")


@settings(max_examples=80, deadline=None)
@given(
    which=st.integers(0, 1),
    places=st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), max_size=4),
)
def test_damage_is_an_input_error_or_nothing(whole_files, which, places):
    files, path = whole_files
    data = bytearray(files[which])
    for place, value in places:
        data[int(place**3 * len(data))] = value  # mostly in the header
    path.write_bytes(data)
    try:
        planes = read_all(path)
    except InputError as error:
        assert str(error).startswith(f"{path}: ") and "\n" not in str(error)
    else:
        assert len({plane.shape for plane in planes.values()}) == 1


# --- writing fails ----------------------------------------------------------------------------------------------------


def test_unwritable_places(tmp_path):
    (tmp_path / "file").touch()
    layers = {"depth": noise(H, W, 1)}
    target = tmp_path / "no" / "a.exr"
    assert (
        message(write_layers, target, layers)
        == f"{target}: cannot be written: No such file or directory; run again when that is solved"
    )
    target = tmp_path / "file" / "a.exr"
    assert (
        message(write_layers, target, layers)
        == f"{target}: cannot be written: Not a directory; run again when that is solved"
    )
    assert "unknown EXR compression 'zap'; known are b44" in message(write_layers, target, layers, compression="zap")


def test_a_full_disk_leaves_the_old_file(tmp_path):
    write_layers(tmp_path / "a.exr", {"depth": np.ones((H, W, 1))})
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        found = message(write_layers, tmp_path / "a.exr", {"depth": noise(H, W, 1)})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert found == f"{tmp_path / 'a.exr'}: cannot be written: File too large; run again when that is solved"
    assert [p.name for p in tmp_path.iterdir()] == ["a.exr"]
    assert (read_all(tmp_path / "a.exr")["depth.Z"] == 1).all()


def test_an_interruption_leaves_no_half_file(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_layers(tmp_path / "a.exr", {"depth": noise(H, W, 1)})
    assert list(tmp_path.iterdir()) == []
