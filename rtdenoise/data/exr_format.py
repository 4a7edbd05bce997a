"""The format of OpenEXR files: parse the header, check that the file is complete, take one part out of many.

Nothing is decoded here. `exr.py` says why OpenEXR's own header reader does not serve.

A file is: magic, version and flags, one header (a list of named attributes) for each part, one table of chunk offsets
for each part, chunks. A chunk is some scanlines or one tile of one part: a leader (part number in multi-part files,
coordinates, number of bytes), then the compressed pixels of all channels of the part. No number in the file is trusted:
the work and the memory are bounded by the file's size.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import InputError
from ..files import open_regular

MAGIC = b"\x76\x2f\x31\x01"
TILED, LONG_NAMES, DEEP, MULTI_PART = 0x200, 0x400, 0x800, 0x1000  # flags beside the version number
PIXEL_TYPES = ("uint", "half", "float")  # in the order of the format's codes
MAX_SIDE = 1 << 16  # pixels; a larger picture is taken for a damaged header before OpenEXR allocates it
MAX_NAME = 255  # bytes, as the format has it
FIRST_READ = 1 << 16  # bytes; most headers are smaller
TABLE_BLOCK = 4096  # chunk offsets that are looked at together


@dataclass(frozen=True)
class Part:
    """One part of a file, as its header describes it."""

    name: str  # "" in single-part files
    attributes: bytes  # the header as stored, without the closing zero
    size: tuple[int, int]  # (width, height) of the data window
    channels: dict[str, str]  # name as stored -> pixel type
    full_names: dict[str, str]  # name qualified with the part's -> name as stored
    tiled: bool
    offsets: np.ndarray = field(repr=False, compare=False)  # uint64: where in the file each chunk starts


@dataclass(frozen=True)
class ExrHeader:
    """What a file holds. Channels of multi-part files carry their part's name in front: `ViewLayer.Combined.R`."""

    path: Path
    width: int  # of the data window of the first part
    height: int
    channels: dict[str, str]  # full channel name -> "half", "float" or "uint"
    parts: tuple[Part, ...] = field(repr=False)
    flags: int = field(repr=False)  # of the version field

    @property
    def summary(self) -> str:
        """The channels on one line, for messages: `R,G,B, albedo.{R,G,B}, depth.Z`."""
        return group_channels(self.channels)


def group_channels(names: Iterable[str]) -> str:
    """Channel names on one line, those of a layer together: `albedo.{R,G,B}, depth.Z`."""
    groups: dict[str, list[str]] = {}
    for name in names:
        layer, _, component = name.rpartition(".")
        groups.setdefault(layer, []).append(component)
    merged = {layer: ",".join(sorted(c, key=lambda c: ("RGBA".find(c), c))) for layer, c in groups.items()}
    braced = {layer: f"{{{c}}}" if "," in c else c for layer, c in merged.items()}
    return ", ".join(f"{layer}.{braced[layer]}" if layer else merged[layer] for layer in groups)


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
        _check_complete(path, file, size, part, header.flags)
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
    _refuse_repeated(path, [full for part in parts for full in part.full_names])
    channels = {full: part.channels[stored] for part in parts for full, stored in part.full_names.items()}
    width, height = parts[0].size
    return ExrHeader(path, width, height, channels, parts, version)


def _parse_attributes(path: Path, cursor: _Cursor) -> tuple[bytes, dict[str, bytes]]:
    """One header: (as stored without the closing zero, attribute name -> value)."""
    start, attributes = cursor.position, {}
    while name := cursor.string():
        cursor.string()  # the type: implied by the names that are used here
        (size,) = cursor.unpack("i")
        attributes[name] = cursor.take(size)
    if missing := [name for name in ("channels", "dataWindow", "compression") if name not in attributes]:
        raise InputError(f"{path}: damaged: the header has no '{missing[0]}'")
    return cursor.data[start : cursor.position - 1], attributes


def _parse_part(path: Path, cursor: _Cursor, raw: bytes, attributes: dict[str, bytes], flags: int) -> Part:
    """Interpret one header; the cursor stands at its chunk table and is moved behind it."""
    storage = attributes.get("type", b"").rstrip(b"\0").decode("utf-8", "replace")
    if storage.startswith("deep"):
        raise InputError(f"{path}: deep pixels cannot be read, only flat images")
    if len(attributes["dataWindow"]) != 16:
        raise InputError(f"{path}: damaged: the data window has {len(attributes['dataWindow'])} bytes, expected 16")
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    if not (0 <= right - left < MAX_SIDE and 0 <= bottom - top < MAX_SIDE):
        raise InputError(f"{path}: damaged: the data window is ({left}, {top}) to ({right}, {bottom})")
    name = attributes.get("name", b"").rstrip(b"\0").decode("utf-8", "replace") if flags & MULTI_PART else ""
    try:
        channels = _parse_channels(attributes["channels"])
    except (_EndOfData, IndexError):
        raise InputError(f"{path}: damaged: the channel list cannot be read") from None
    if long := [text for text in (name, *(stored for stored, _ in channels)) if len(text) > MAX_NAME]:
        raise InputError(f"{path}: damaged: a name of {len(long[0])} characters, at most {MAX_NAME} are allowed")
    full_names = [_full_name(name, stored) for stored, _ in channels]
    _refuse_repeated(path, full_names)
    return Part(
        name=name,
        attributes=raw,
        size=(right - left + 1, bottom - top + 1),
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


def _refuse_repeated(path: Path, names: list[str]) -> None:
    seen = set()
    for name in names:
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


def find_table_end(
    offsets: np.ndarray,  # uint64, a stretch of a chunk table and perhaps more behind it
    position: int,  # of the stretch in the file
    least: int,  # the least offset in front of the stretch
) -> tuple[int | None, int]:
    """(how many of the offsets belong to the table, the least offset so far); None: all, and the table goes on."""
    running = np.minimum.accumulate(np.minimum(offsets, np.uint64(least)))
    ends = position + 8 * np.arange(1, len(offsets) + 1, dtype=np.uint64)
    last = np.flatnonzero(ends >= running)
    return (int(last[0]) + 1 if last.size else None), int(running[-1])


def _full_name(part: str, channel: str) -> str:
    """Qualify a channel with its part's name: parts `VL.Depth` hold `Z`, `Depth.Z` or `VL.Depth.Z`, by writer."""
    components, qualified = channel.split("."), part.split(".") if part else []
    for overlap in range(min(len(qualified), len(components) - 1), 0, -1):
        if qualified[-overlap:] == components[:overlap]:
            return ".".join(qualified + components[overlap:])
    return channel if len(components) > 1 or not part else f"{part}.{channel}"


def _chunk_layout(part: Part, flags: int) -> str:
    """struct layout of what stands in front of a chunk's data; the last number is the data's size."""
    return "<" + "i" * bool(flags & MULTI_PART) + ("iiiii" if part.tiled else "ii")


def _check_complete(path: Path, file: BinaryIO, size: int, part: Part, flags: int) -> None:
    """No chunk may be missing, and the chunk that lies last must end inside the file."""
    if not len(part.offsets) or not part.offsets.all():
        missing = int((part.offsets == 0).sum())
        raise InputError(f"{path}: truncated: {missing} of {len(part.offsets)} chunks were never written "
                         "(an interrupted render?)")  # fmt: skip
    layout = _chunk_layout(part, flags)
    start = int(part.offsets.max())
    end = start + struct.calcsize(layout)
    if end <= size:
        file.seek(start)
        length = struct.unpack(layout, file.read(struct.calcsize(layout)))[-1]
        if length < 0:
            raise InputError(f"{path}: damaged: {_of(part)} has {length} bytes")
        end += length
    if end > size:
        raise InputError(f"{path}: truncated: has {size} bytes, the last chunk ends at {end}")


def single_part(header: ExrHeader, index: int) -> bytes:
    """One part of a multi-part file as a file of its own: the same header and chunks, without the part numbers. Raises
    InputError for chunks that cannot be right."""
    part = header.parts[index]
    layout = _chunk_layout(part, header.flags)
    chunks, total = [], 0
    with open_regular(header.path) as file:
        size = os.fstat(file.fileno()).st_size
        for offset in part.offsets.tolist():
            file.seek(offset)
            leader = file.read(struct.calcsize(layout))
            number, *_, length = struct.unpack(layout, leader)
            if number != index:
                raise InputError(f"{header.path}: damaged: {_of(part)} says that it belongs to part {number}")
            if not 0 <= length <= size - offset - len(leader):
                raise InputError(f"{header.path}: damaged: {_of(part)} has {length} bytes")
            total += len(leader) + length
            if total > size:
                raise InputError(f"{header.path}: damaged: the chunks of part '{part.name}' hold more bytes than the "
                                 "file")  # fmt: skip
            chunks.append(leader[4:] + file.read(length))
    version = 2 | (header.flags & LONG_NAMES) | (TILED if part.tiled else 0)
    start = MAGIC + struct.pack("<I", version) + part.attributes + b"\0"
    first = len(start) + 8 * len(chunks)
    lengths = np.array([0] + [len(chunk) for chunk in chunks[:-1]])
    return start + (first + np.cumsum(lengths)).astype("<u8").tobytes() + b"".join(chunks)


def _of(part: Part) -> str:
    return f"a chunk of part '{part.name}'" if part.name else "a chunk"
