"""Files that are damaged in any way are refused with one line, or read; nothing else."""

import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rtdenoise.data.exr import read_channels, read_header, write_layers
from rtdenoise.data.sequences import open_sequence
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


@BOUNDED
@given(noise=st.binary(max_size=600), magic=st.booleans())
def test_noise(tmp_path, noise, magic):
    survives(tmp_path / "frame.0001.exr", (b"\x76\x2f\x31\x01\x02\0\0\0" if magic else b"") + noise)
