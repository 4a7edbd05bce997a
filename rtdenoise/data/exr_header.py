"""Parse the header of an OpenEXR file: attributes, channels, and where the chunks are."""

from __future__ import annotations

import os
import re
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import InputError
from .exr_chunks import check_complete, find_table_end
from .exr_format import DEEP, MAGIC, MULTI_PART, TILED, ExrHeader, Part

PIXEL_TYPES = ("uint", "half", "float")  # in the order of the format's codes
MAX_SIDE, MAX_PIXELS = 1 << 16, 1 << 28  # a larger picture is a damaged header; OpenEXR would allocate it
MAX_COORDINATE, MAX_ASPECT = (1 << 30) - 2, 1e6  # OpenEXR writes no larger ones
MAX_NAME = 255  # bytes, as the format has it
FIRST_READ = 1 << 16  # bytes; most headers are smaller
REPLACED = "\ufffd"  # what decoding puts where bytes are no UTF-8
TABLE_BLOCK = 4096  # chunk offsets that are looked at together


class _EndOfData(Exception):
    """The parser needs more bytes than it was given."""


class _Cursor:
    """Reads the primitives of the file format from bytes."""

    def __init__(self, data: bytes) -> None:
        self.data, self.position = data, 0

    def take(self, count: int) -> bytes:
        if count < 0 or self.position + count > len(self.data):
            raise _EndOfData
        self.position += count
        return self.data[self.position - count : self.position]

    def unpack(self, layout: str) -> tuple:
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def string(self) -> str:
        end = self.data.find(b"\0", self.position)
        if end < 0:
            raise _EndOfData
        text = self.take(end - self.position)
        self.position += 1
        return text.decode("utf-8", "replace")


def parse_file(path: Path, file: BinaryIO) -> ExrHeader:
    """Parse the header and check the chunk tables. Reads more of the file while the header has not ended: it may carry
    previews or manifests."""
    size = os.fstat(file.fileno()).st_size
    window = FIRST_READ
    while True:
        file.seek(0)
        head = file.read(min(window, size))
        try:
            header = _parse(path, head)
            break
        except _EndOfData:
            if window >= size:
                raise InputError(
                    f"{path}: truncated or damaged: the header does not end within the {size} bytes"
                ) from None
            window *= 16
    for part in header.parts:
        check_complete(path, file, size, part, header.flags)
    return header


def _parse(path: Path, head: bytes) -> ExrHeader:
    cursor = _Cursor(head)
    if not head:
        raise InputError(f"{path}: the file is empty (0 bytes)")
    if not head.startswith(MAGIC):
        if MAGIC.startswith(head):
            raise _EndOfData
        raise InputError(f"{path}: not an OpenEXR file: starts with {head[:4]!r}")
    _, version = cursor.unpack("II")
    if version & 0xFF != 2 or version & DEEP:
        kind = "deep pixels" if version & DEEP else f"version {version & 0xFF} of the format"
        raise InputError(f"{path}: {kind} cannot be read, only flat images of version 2")
    descriptions = [_parse_attributes(path, cursor)]
    while version & MULTI_PART and cursor.data[cursor.position : cursor.position + 1] != b"\0":
        descriptions.append(_parse_attributes(path, cursor))
    cursor.position += bool(version & MULTI_PART)
    parts = tuple(_parse_part(path, cursor, raw, found, version) for raw, found in descriptions)
    views = [found["view"].decode("utf-8", "replace") for _, found in descriptions if "view" in found]
    _refuse_repeated(path, [full for part in parts for full in part.full_names], tuple(dict.fromkeys(views)))
    channels = {full: part.channels[stored] for part in parts for full, stored in part.full_names.items()}
    width, height = parts[0].size
    first = descriptions[0][1]
    return ExrHeader(path, width, height, channels, parts, version, _samples(first), _placing(first))


def _parse_attributes(path: Path, cursor: _Cursor) -> tuple[bytes, dict[str, bytes]]:
    """One header: (as stored without the closing zero, attribute name -> value). In texts that are not UTF-8, as older
    programs write them, "?" stands for each byte beyond ASCII: OpenEXR's Python would refuse the file."""
    start, attributes, mended = cursor.position, {}, {}
    while name := cursor.string():
        kind = cursor.string()  # else implied by the names that are used here
        (size,) = cursor.unpack("i")
        position, value = cursor.position, cursor.take(size)
        if kind == "string" and value.decode("utf-8", "replace").encode() != value:
            mended[position - start] = value = re.sub(rb"[\x80-\xff]", b"?", value)
        attributes[name] = value
    if missing := [name for name in ("channels", "dataWindow", "compression") if name not in attributes]:
        raise InputError(f"{path}: damaged: the header has no '{missing[0]}'")
    stored = bytearray(cursor.data[start : cursor.position - 1])
    for position, value in mended.items():
        stored[position : position + len(value)] = value
    return bytes(stored), attributes


def _samples(attributes: dict[str, bytes]) -> int:
    """Samples a pixel that Cycles noted as `cycles.ViewLayer.samples`, those of the view layer with fewest; 0: none."""
    noted = [v for name, v in attributes.items() if name.startswith("cycles.") and name.endswith(".samples")]
    return min((int(value) for value in noted if value.isdigit() and len(value) < 10), default=0)


def _placing(attributes: dict[str, bytes]) -> dict[str, object]:
    """Where the pixels lie in the picture, and which shape and colours they have, as attributes of another header: data
    and display window, pixel aspect, chromaticities. What OpenEXR would not write counts as missing."""

    def values(name: str, form: str, most: float) -> tuple | None:
        stored = attributes.get(name, b"")
        found = struct.unpack(form, stored) if len(stored) == struct.calcsize(form) else None
        return found if found and all(abs(value) <= most for value in found) else None  # not NaN either

    def window(name: str) -> tuple[tuple[int, int], tuple[int, int]] | None:
        left, top, right, bottom = values(name, "<4i", MAX_COORDINATE) or (0, 0, -1, -1)
        return ((left, top), (right, bottom)) if left <= right and top <= bottom else None

    data = window("dataWindow")
    if data is None:
        return {}
    (aspect,) = values("pixelAspectRatio", "<f", MAX_ASPECT) or (1.0,)
    colours = values("chromaticities", "<8f", MAX_COORDINATE)
    return {
        "dataWindow": data, "displayWindow": window("displayWindow") or data,
        "pixelAspectRatio": aspect if aspect >= 1 / MAX_ASPECT else 1.0,
    } | ({"chromaticities": colours} if colours else {})  # fmt: skip


def _parse_part(path: Path, cursor: _Cursor, raw: bytes, attributes: dict[str, bytes], flags: int) -> Part:
    """Interpret one header; the cursor stands at its chunk table and is moved behind it."""
    storage = attributes.get("type", b"").rstrip(b"\0").decode("utf-8", "replace")
    if storage.startswith("deep"):
        raise InputError(f"{path}: deep pixels cannot be read, only flat images")
    if len(attributes["dataWindow"]) != 16:
        raise InputError(f"{path}: damaged: the data window has {len(attributes['dataWindow'])} bytes, expected 16")
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and width * height <= MAX_PIXELS):
        raise InputError(f"{path}: damaged: the data window is ({left}, {top}) to ({right}, {bottom})")
    name = attributes.get("name", b"").rstrip(b"\0").decode("utf-8", "replace") if flags & MULTI_PART else ""
    try:
        channels = _parse_channels(attributes["channels"])
    except (_EndOfData, IndexError):
        raise InputError(f"{path}: damaged: the channel list cannot be read") from None
    if long := [text for text in (name, *(stored for stored, _ in channels)) if len(text) > MAX_NAME]:
        raise InputError(f"{path}: damaged: a name of {len(long[0])} characters, at most {MAX_NAME} are allowed")
    if foreign := [stored for stored, _ in channels if REPLACED in stored]:  # OpenEXR's Python cannot return them
        raise InputError(f"{path}: the channel name '{foreign[0]}' is not in UTF-8; rename it in the renderer")
    full_names = [_full_name(name, stored) for stored, _ in channels]
    _refuse_repeated(path, full_names)
    return Part(
        name=name,
        attributes=raw,
        size=(width, height),
        corner=(left, top),
        channels=dict(channels),
        full_names=dict(zip(full_names, (stored for stored, _ in channels), strict=True)),
        tiled=storage == "tiledimage" or bool(flags & TILED),
        offsets=_parse_chunk_table(path, cursor, attributes),
    )


def _parse_channels(value: bytes) -> list[tuple[str, str]]:
    """(name, pixel type) of every channel."""
    cursor, channels = _Cursor(value), []
    while name := cursor.string():
        code, *_ = cursor.unpack("IIii")
        channels.append((name, PIXEL_TYPES[code]))
    return channels


def _refuse_repeated(path: Path, names: list[str], views: tuple[str, ...] = ()) -> None:
    seen = set()
    for name in names:
        if name in seen and len(views) > 1:
            raise InputError(f"{path}: holds several views ({', '.join(views)}) with channels of one name, such as "
                             f"'{name}'; write each view into files of its own")  # fmt: skip
        if name in seen:
            raise InputError(f"{path}: two channels are called '{name}'; rename one")
        seen.add(name)


def _parse_chunk_table(path: Path, cursor: _Cursor, attributes: dict[str, bytes]) -> np.ndarray:
    if "chunkCount" in attributes:
        (count,) = struct.unpack("<i", attributes["chunkCount"].ljust(4, b"\0")[:4])
        return np.frombuffer(cursor.take(8 * max(count, 0)), "<u8")
    # Single-part files do not say how many chunks they have, but the table ends where the first of them starts.
    blocks, least, count = [], 2**64 - 1, None
    while count is None:
        start = cursor.position
        block = np.frombuffer(cursor.take(min(8 * TABLE_BLOCK, max(len(cursor.data) - start & ~7, 8))), "<u8")
        count, least = find_table_end(block, start, least)
        block = block[:count]
        blocks.append(block)
        cursor.position = start + 8 * len(block)
        if block[-1] < cursor.position:
            number = sum(map(len, blocks)) - 1
            raise InputError(f"{path}: truncated: chunk {number} was never written (an interrupted render?)")
    return np.concatenate(blocks)


def _full_name(part: str, channel: str) -> str:
    """Qualify a channel with its part's name: parts `VL.Depth` hold `Z`, `Depth.Z` or `VL.Depth.Z`, by writer."""
    components, qualified = channel.split("."), part.split(".") if part else []
    for overlap in range(min(len(qualified), len(components) - 1), 0, -1):
        if qualified[-overlap:] == components[:overlap]:
            return ".".join(qualified + components[overlap:])
    return channel if len(components) > 1 or not part else f"{part}.{channel}"
