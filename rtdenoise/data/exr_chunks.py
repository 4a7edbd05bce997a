"""The chunks of OpenEXR files: where their table ends, whether all are there, and one part as a file of its own."""

from __future__ import annotations

import os
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import InputError
from ..files import open_regular
from .exr_format import LONG_NAMES, MAGIC, MULTI_PART, TILED, ExrHeader, Part


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


def _chunk_layout(part: Part, flags: int) -> str:
    """struct layout of a chunk's leader; its last number is the size of the data."""
    return "<" + "i" * bool(flags & MULTI_PART) + ("iiiii" if part.tiled else "ii")


def check_complete(path: Path, file: BinaryIO, size: int, part: Part, flags: int) -> None:
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
    start = single_start(header, index)
    first = len(start) + 8 * len(chunks)
    lengths = np.array([0] + [len(chunk) for chunk in chunks[:-1]])
    return start + (first + np.cumsum(lengths)).astype("<u8").tobytes() + b"".join(chunks)


def single_start(header: ExrHeader, index: int) -> bytes:
    """The start of `single_part`, to the end of its header."""
    part = header.parts[index]
    version = 2 | (header.flags & LONG_NAMES) | (TILED if part.tiled else 0)
    return MAGIC + struct.pack("<I", version) + part.attributes + b"\0"


def _of(part: Part) -> str:
    return f"a chunk of part '{part.name}'" if part.name else "a chunk"
