"""The parts of the OpenEXR format that are read without decoding pixels; `exr.py` says why.

A file is: magic, version and flags, one header (a list of named attributes) for each part, one table of chunk offsets
for each part, chunks. A chunk is some scanlines or one tile of one part: a leader (part number in multi-part files,
coordinates, number of bytes), then the compressed pixels of all channels of the part.

`exr_header.py` parses the headers, `exr_chunks.py` finds the chunks. They trust no number in the file: the file's size
bounds their work and memory.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

MAGIC = b"\x76\x2f\x31\x01"
TILED, LONG_NAMES, DEEP, MULTI_PART = 0x200, 0x400, 0x800, 0x1000  # flags beside the version number


@dataclass(frozen=True)
class Part:
    """One part of a file, as its header describes it."""

    name: str  # "" in single-part files
    attributes: bytes  # the header as stored, without the closing zero; all texts in it are UTF-8
    size: tuple[int, int]  # (width, height) of the data window
    corner: tuple[int, int]  # (x, y) at which it begins
    channels: dict[str, str]  # name as stored -> pixel type
    full_names: dict[str, str]  # name qualified with the part's -> name as stored
    tiled: bool
    offsets: np.ndarray = field(repr=False, compare=False)  # uint64: where in the file each chunk starts


@dataclass(frozen=True)
class ExrHeader:
    """The content of a file. Channels of multi-part files carry their part's name in front: `ViewLayer.Combined.R`."""

    path: Path
    width: int  # of the data window of the first part
    height: int
    channels: dict[str, str]  # full channel name -> "half", "float" or "uint"
    parts: tuple[Part, ...] = field(repr=False)
    flags: int = field(repr=False)  # of the version field
    samples: int = 0  # a pixel, as the renderer noted them; 0: unknown
    placing: dict[str, object] = field(default_factory=dict)  # attributes of the first part: windows, aspect, colours

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
    merged = {layer: ",".join(sorted(c, key=lambda c: ("RGBA".find(c) % 5, c))) for layer, c in groups.items()}
    braced = {layer: f"{{{c}}}" if "," in c else c for layer, c in merged.items()}
    return ", ".join(f"{layer}.{braced[layer]}" if layer else merged[layer] for layer in groups)
