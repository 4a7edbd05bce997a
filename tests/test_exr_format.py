"""Crafted OpenEXR files: refused in one line, in time and memory that the file's size bounds."""

from __future__ import annotations

import struct
import time
import tracemalloc

import numpy as np
import OpenEXR
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rtdenoise.data.exr import read_channels, read_header, write_like
from rtdenoise.data.exr_chunks import find_table_end
from rtdenoise.data.exr_format import MULTI_PART, TILED
from rtdenoise.errors import InputError

MAGIC = 20000630


def attribute(name, kind, value):
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


def channel_list(*names):
    return b"".join(name.encode() + b"\0" + struct.pack("<iIii", 2, 0, 1, 1) for name in names) + b"\0"


def header(width, height, channels=("X",), part="", count=None, compression=0, kind="scanlineimage"):
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = [
        attribute("channels", "chlist", channel_list(*channels)),
        attribute("compression", "compression", bytes([compression])),
        attribute("dataWindow", "box2i", box), attribute("displayWindow", "box2i", box),
        attribute("lineOrder", "lineOrder", b"\0"), attribute("pixelAspectRatio", "float", struct.pack("<f", 1)),
        attribute("screenWindowCenter", "v2f", bytes(8)), attribute("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]  # fmt: skip
    if part:
        attributes += [attribute("name", "string", part.encode()), attribute("type", "string", kind.encode())]
        attributes.append(attribute("chunkCount", "int", struct.pack("<i", count)))
    return b"".join(attributes) + b"\0"


def start(flags=0):
    return struct.pack("<II", MAGIC, 2 | flags)


def multi_part(parts, chunks):
    """`parts` = [(name, channels)] of one row and four columns, `chunks` = [(part number, size, data)], one a part."""
    head = start(MULTI_PART) + b"".join(header(4, 1, channels, name, 1) for name, channels in parts) + b"\0"
    position, offsets, body = len(head) + 8 * len(chunks), [], b""
    for number, size, data in chunks:
        offsets.append(position + len(body))
        body += struct.pack("<iii", number, 0, size) + data
    return head + struct.pack(f"<{len(offsets)}Q", *offsets) + body


def message(function, *args) -> str:
    with pytest.raises(InputError) as caught:
        function(*args)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 1000
    return str(caught.value)


# --- chunk tables -----------------------------------------------------------------------------------------------------


def slow_table_end(offsets, position):
    """As the format has it: the table ends where the first of the chunks begins."""
    for count in range(1, len(offsets) + 1):
        if position + 8 * count >= min(offsets[:count]):
            return count
    return None


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(0, 400), min_size=1, max_size=40), st.integers(0, 100))
def test_the_end_of_the_table(offsets, position):
    assert find_table_end(np.array(offsets, np.uint64), position, 2**64 - 1)[0] == slow_table_end(offsets, position)


def test_many_small_tiles_are_read_in_no_time(tmp_path):
    tiles = OpenEXR.TileDescription()
    tiles.xSize = tiles.ySize = 16
    made = {"type": OpenEXR.tiledimage, "tiles": tiles, "compression": OpenEXR.ZIP_COMPRESSION}
    OpenEXR.File(made, {"X": np.zeros((2160, 3840), np.float16)}).write(str(tmp_path / "a.exr"))
    began = time.perf_counter()
    assert len(read_header(tmp_path / "a.exr").parts[0].offsets) == 240 * 135
    assert time.perf_counter() - began < 1


@pytest.mark.parametrize("descending", [False, True])
def test_a_table_that_fills_the_file(tmp_path, descending):
    """No chunk begins before the end of the file, so that the table seems to go on to there."""
    head, count = start(TILED) + header(16000, 16000), 150_000
    size = len(head) + 8 * count
    offsets = size + 10 + np.arange(count, dtype="<u8")[:: -1 if descending else 1]
    (tmp_path / "a.exr").write_bytes(head + offsets.tobytes())
    began = time.perf_counter()
    assert "truncated" in message(read_header, tmp_path / "a.exr")
    assert time.perf_counter() - began < 2


def test_a_count_of_chunks_beyond_the_file(tmp_path):
    head = start(MULTI_PART) + header(4, 4, part="A", count=2**31 - 1) + b"\0"
    (tmp_path / "a.exr").write_bytes(head + bytes(1000))
    tracemalloc.start()
    assert "truncated or damaged: the header does not end" in message(read_header, tmp_path / "a.exr")
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()


def test_a_picture_that_no_memory_holds(tmp_path):
    (tmp_path / "a.exr").write_bytes(start() + header(65000, 65000) + bytes(100))
    assert "damaged: the data window is (0, 0) to (64999, 64999)" in message(read_header, tmp_path / "a.exr")


# --- chunks -----------------------------------------------------------------------------------------------------------


PARTS = [("A", ["X"]), ("B", ["X"])]
ROW = np.arange(4, dtype="<f4").tobytes()


def test_the_crafted_files_are_valid_to_begin_with(tmp_path):
    (tmp_path / "a.exr").write_bytes(multi_part(PARTS, [(0, 16, ROW), (1, 16, ROW)]))
    assert read_channels(tmp_path / "a.exr", ["A.X", "B.X"])["B.X"].tolist() == [[0, 1, 2, 3]]


def test_texts_that_are_not_utf8(tmp_path):
    """As programs on Windows write names of people and folders."""
    owner = attribute("owner", "string", "Müller".encode("latin-1"))
    one = start() + header(4, 1)[:-1] + owner + b"\0"
    one += struct.pack("<Q", len(one) + 8) + struct.pack("<ii", 0, 16) + ROW
    name, latin = (attribute("name", "string", text) for text in (b"A", b"\xfc"))
    two = multi_part(PARTS, [(0, 16, ROW), (1, 16, ROW)]).replace(name, latin)
    for stored, channel in ((one, "X"), (two, "?.X")):
        (tmp_path / "a.exr").write_bytes(stored)
        assert read_channels(tmp_path / "a.exr", [channel])[channel].tolist() == [[0, 1, 2, 3]]
    (tmp_path / "a.exr").write_bytes(one)
    write_like(tmp_path / "b.exr", tmp_path / "a.exr", {"X": np.ones((1, 4), np.float32)})
    assert OpenEXR.File(str(tmp_path / "b.exr")).header()["owner"] == "M?ller"


def test_a_channel_whose_name_is_not_utf8(tmp_path):
    stored = start() + header(4, 1, ["R", "zR"]).replace(b"zR", b"\xe9R")
    stored += struct.pack("<Q", len(stored) + 8) + struct.pack("<ii", 0, 32) + 2 * ROW
    (tmp_path / "a.exr").write_bytes(stored)
    assert "the channel name '\ufffdR' is not in UTF-8" in message(read_header, tmp_path / "a.exr")


@pytest.mark.parametrize("size", [-1, -(2**31), 2**31 - 1, 100])
@pytest.mark.parametrize("which", [0, 1])
def test_sizes_of_chunks_that_cannot_be(tmp_path, size, which):
    chunks = [(0, 16, ROW), (1, 16, ROW)]
    chunks[which] = (which, size, ROW)
    (tmp_path / "a.exr").write_bytes(multi_part(PARTS, chunks) + bytes(30) * which)
    found = message(read_channels, tmp_path / "a.exr", ["A.X", "B.X"])
    assert "truncated" in found or f"damaged: a chunk of part '{'AB'[which]}' has {size} bytes" in found


def test_chunks_that_overlap_are_not_read_over_and_over(tmp_path):
    """Each of 20,000 table entries names the same megabyte: 20 GB."""
    count, size = 20_000, 1_000_000
    head = start(MULTI_PART) + header(4, count, part="A", count=count) + header(4, count, part="B", count=1) + b"\0"
    first = len(head) + 8 * (count + 1)
    table = np.full(count + 1, first, "<u8").tobytes()
    (tmp_path / "a.exr").write_bytes(head + table + struct.pack("<iii", 0, 0, size) + bytes(size))
    assert "damaged: the chunks of part 'A' hold more bytes than the file" in message(
        read_channels, tmp_path / "a.exr", ["A.X"]
    )


def test_a_chunk_of_another_part(tmp_path):
    (tmp_path / "a.exr").write_bytes(multi_part(PARTS, [(0, 16, ROW), (0, 16, ROW)]))
    assert "damaged: a chunk of part 'B' says that it belongs to part 0" in message(
        read_channels, tmp_path / "a.exr", ["B.X"]
    )


# --- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "parts",
    [
        [("L.A", ["X"]), ("L.A", ["X"])],
        [("M", ["L.A.X"]), ("L.A", ["X"])],
        [("L.A", ["L.A.X", "X"])],
        [("A", ["X", "X"]), ("B", ["X"])],
    ],
)
def test_two_channels_of_one_name(tmp_path, parts):
    chunks = [(i, 16 * len(channels), ROW * len(channels)) for i, (_, channels) in enumerate(parts)]
    (tmp_path / "a.exr").write_bytes(multi_part(parts, chunks))
    found = message(read_header, tmp_path / "a.exr")
    assert found.startswith(f"{tmp_path / 'a.exr'}: two channels are called '") and found.endswith("rename one")


@pytest.mark.parametrize("name", ["a." * 500_000 + "a", "b" * 256])
def test_names_longer_than_the_format_allows(tmp_path, name):
    (tmp_path / "a.exr").write_bytes(multi_part([(name, [name])], [(0, 16, ROW)]))
    assert "damaged: a name of " in message(read_header, tmp_path / "a.exr")
