"""OpenEXR files as named channels: read the header, read the wanted channels, write layers.

OpenEXR decodes and encodes (3.5 or later: streams). `exr_header.py` parses the header, for three reasons seen with the
Python API of OpenEXR 3.5.3:

- `OpenEXR.File(path, header_only=True)` gives the names of the channels but not their pixel types.
- `OpenEXR.File(path)` of a truncated or damaged file prints a warning, drops the broken part and succeeds. Here the
  chunk table is checked against the file's size first, and a part that cannot be decoded is an `InputError`.
- It decodes every part. Cycles writes one part for each pass, and a denoiser wants few of them: here only the wanted
  parts are read from the disk and handed over, each as a single-part file in memory (1 of 13 parts of a 960×540 file:
  15 ms against 270 ms). The channels of one part share compressed blocks, so all are decoded and the rest is dropped;
  decoding one alone would save next to nothing (7 ms for 1 of 29 channels, 8 ms for all).
"""

from __future__ import annotations

import io
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
import OpenEXR

from ..constants import MAX_HALF
from ..errors import InputError
from ..files import open_regular, read_bytes, write_atomically
from .exr_attributes import STRUCTURE, attributes_of, has_type
from .exr_chunks import single_part
from .exr_format import ExrHeader, Part
from .exr_header import parse_file
from .layers import LAYERS

NUMPY_TYPES = {"uint": np.uint32, "half": np.float16, "float": np.float32}
START = 8  # bytes in front of the attributes: magic, version and flags
DECODER_NEEDS = 3  # times the decoded pixels: the file, OpenEXR's buffers, the result

GEOMETRY = {name: layer.components for name, layer in LAYERS.items() if layer.components != "RGB"}


def read_header(path: str | os.PathLike) -> ExrHeader:
    """Parse the header and check that the file is complete. No pixel is read.

    Raises `InputError` where the file cannot be opened, is no OpenEXR file, is truncated, was never finished, or holds
    deep pixels.
    """
    path = Path(path)
    with open_regular(path) as file:
        try:
            return parse_file(path, file)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def read_channels(path: str | os.PathLike, names: Sequence[str], as_stored: bool = False) -> dict[str, np.ndarray]:
    """The pixels `[H, W]` float32 of the channels `names` (full names, as `read_header` gives them).

    uint channels come back as float32 too, exact up to 2^24; with `as_stored` all have their own types. Only the parts
    that hold a wanted channel are read. Raises `InputError` as `read_header` does, and for a channel that is missing or
    cannot be decoded.
    """
    header = read_header(path)
    path = header.path
    if missing := [name for name in names if name not in header.channels]:
        raise InputError(f"{path}: no channel '{missing[0]}'; the file has {header.summary}")
    pixels: dict[str, np.ndarray] = {}
    for index, part in enumerate(header.parts):
        wanted = {full: stored for full, stored in part.full_names.items() if full in names}
        if not wanted:
            continue
        if part.size != (header.width, header.height):
            raise InputError(f"{path}: part '{part.name}' is {part.size[0]}×{part.size[1]}, "
                             f"the first part {header.width}×{header.height}")  # fmt: skip
        if part.corner != header.parts[0].corner:
            raise InputError(f"{path}: the data window of part '{part.name}' begins at {part.corner}, that of the "
                             f"first part at {header.parts[0].corner}; render both with one")  # fmt: skip
        decoded = _decode(path, header, index)
        for full, stored in wanted.items():
            if stored not in decoded or decoded[stored].shape != (header.height, header.width):
                found = decoded[stored].shape if stored in decoded else "nothing"
                raise InputError(f"{path}: damaged, or subsampled: channel '{full}' decodes to {found}, "
                                 f"expected ({header.height}, {header.width})")  # fmt: skip
            pixels[full] = decoded[stored] if as_stored else decoded[stored].astype(np.float32)
    return {name: pixels[name] for name in names}


def read_attributes(path: str | os.PathLike, kept: Collection[str] = ()) -> dict[str, object]:
    """What the first part's header says of the picture besides `ExrHeader.placing`, for `write_layers`: colour space,
    time, camera, comments; and what any part's says of Cryptomatte in the channels `kept` (full names). Without what
    OpenEXR cannot read.

    Raises `InputError` as `read_header` does."""
    return attributes_of(read_header(path), kept)


def write_layers(
    path: str | os.PathLike,
    layers: Mapping[str, np.ndarray],  # layer -> [H, W, C], or full channel name -> [H, W]
    *,
    dtypes: Mapping[str, str] | None = None,  # key of `layers` -> "half", "float" or "uint"
    compression: str = "zip",
    attributes: Mapping[str, object] | None = None,  # further header attributes
) -> None:
    """Write layers under their native names and types (`layers.py`), as one part.

    `color` becomes `R,G,B`, `normal` becomes `normal.{X,Y,Z}`. A layer that the table lacks becomes `name.{R,G,B}`,
    with 4 channels `name.{R,G,B,A}`, with 2 `name.{X,Y}`, with 1 `name.V`, stored as half. `dtypes` overrides the
    types. A key with an array of two axes is a complete channel name and is kept. Half clamps values beyond ±65504,
    infinity too; NaN stays NaN.

    The file appears under its name only when it is complete: an interrupted run leaves no half file. Raises
    `InputError` where it cannot be written.
    """
    path = Path(path)
    channels = {}
    for key, array in layers.items():
        dtype = (dtypes or {}).get(key) or _default_dtype(key)
        for name, plane in _planes(key, np.asarray(array)):
            channels[name] = _convert(plane, dtype)
    if len(sizes := {plane.shape for plane in channels.values()}) != 1:
        raise ValueError(f"{path}: expected layers of one size, got {sorted(sizes)}")
    header = {"compression": _compression(compression), "type": OpenEXR.scanlineimage, **(attributes or {})}
    encoded = io.BytesIO()
    OpenEXR.File(header, channels).write(encoded)
    write_atomically(path, encoded.getbuffer())


def write_like(
    path: str | os.PathLike,
    source: str | os.PathLike,
    changed: Mapping[str, np.ndarray],  # full channel name -> [H, W]
    *,
    dtype: str | None = None,  # of the changed channels: "half" or "float"; None: as in the source, no whole numbers
) -> dict[str, int]:
    """Write a copy of `source` with other pixels in some of its channels. Returns the number of NaNs in each unchanged
    channel that has some, by full channel name.

    Parts, channel names, pixel types and attributes stay; pixels are stored as scan lines with ZIP compression. Raises
    `InputError` as `read_channels` and `write_layers` do.
    """
    header = read_header(source)
    parts, nans = [], {}
    for index, part in enumerate(header.parts):
        copy = _open(header.path, header, index)
        found = copy.header().items()
        attributes = {name: value for name, value in found if name not in STRUCTURE and has_type(value)}
        attributes |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        stored = {name: channel.pixels for name, channel in copy.channels().items()}
        passed_on = {full: stored[name] for full, name in part.full_names.items() if full not in changed}
        nans |= {full: count for full, plane in passed_on.items() if (count := int(np.isnan(plane).sum()))}
        for full in changed.keys() & part.full_names.keys():
            name = part.full_names[full]
            as_in_source = part.channels[name] if part.channels[name] != "uint" else "float"
            stored[name] = _convert(changed[full], dtype or as_in_source)
        parts.append(OpenEXR.Part(attributes, stored, part.name))
    encoded = io.BytesIO()
    OpenEXR.File(parts).write(encoded)
    write_atomically(Path(path), encoded.getbuffer())
    return nans


def _default_dtype(key: str) -> str:
    layer = LAYERS.get(key.split(".")[0])
    return layer.exr_type if layer else "half"


def _planes(key: str, array: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """(channel name, [H, W]) of one entry of `write_layers`."""
    if array.ndim == 2:
        return [(key, array)]
    count = array.shape[2] if array.ndim == 3 else 0
    components = GEOMETRY.get(key) or {1: "V", 2: "XY", 3: "RGB", 4: "RGBA"}.get(count, "")
    if len(components) != count or not count:
        raise ValueError(f"layer '{key}': expected [H, W, {len(components) or '1..4'}], got {array.shape}")
    prefix = "" if key == "color" else f"{key}."
    return [(prefix + component, array[:, :, i]) for i, component in enumerate(components)]


def _convert(plane: np.ndarray, dtype: str) -> np.ndarray:
    if plane.dtype == NUMPY_TYPES[dtype]:  # as it was stored, infinity included
        return np.ascontiguousarray(plane)
    if dtype == "half":
        plane = np.clip(plane, -MAX_HALF, MAX_HALF)
    elif dtype == "uint":
        plane = np.rint(np.clip(np.nan_to_num(plane.astype(np.float64)), 0, 2**32 - 1))
    return np.ascontiguousarray(plane, dtype=NUMPY_TYPES[dtype])


def _compression(name: str) -> OpenEXR.Compression:
    known = {c.removesuffix("_COMPRESSION").lower(): c for c in dir(OpenEXR) if c.endswith("_COMPRESSION")}
    known["none"] = known.pop("no")
    if name not in known:
        raise InputError(f"unknown EXR compression '{name}'; known are {', '.join(sorted(known))}")
    return getattr(OpenEXR, known[name])


def _decode(path: Path, header: ExrHeader, index: int) -> dict[str, np.ndarray]:
    """Every channel of one part, `[H, W]` in its own type, under the names as stored."""
    return {name: channel.pixels for name, channel in _open(path, header, index).channels().items()}


def _refuse_without_memory(path: Path, part: Part) -> None:
    """Raise InputError where there is too little memory for the decoded part: OpenEXR does not tell it from damage."""
    needed = 4 * part.size[0] * part.size[1] * len(part.channels)
    try:
        np.empty(DECODER_NEEDS * needed, np.uint8)
    except MemoryError:
        raise InputError(f"{path}: out of memory, or damaged: {needed / 1e6:.0f} MB of pixels could not be "
                         "decoded") from None  # fmt: skip


def _open(path: Path, header: ExrHeader, index: int) -> OpenEXR.File:
    """One part of a file, decoded, as a file of its own."""
    attributes = header.parts[index].attributes
    try:
        data = read_bytes(path) if len(header.parts) == 1 else single_part(header, index)
        if not data.startswith(attributes, START):
            data = data[:START] + attributes + data[START + len(attributes) :]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        decoded = OpenEXR.File(io.BytesIO(data), separate_channels=True)
        decoded.channels()
    except (RuntimeError, ValueError, ArithmeticError, OSError, MemoryError):
        # OpenEXR drops a part that it cannot decode, then complains that there is no part: not worth passing on.
        _refuse_without_memory(path, header.parts[index])
        raise InputError(f"{path}: damaged: the pixels cannot be decoded") from None
    return decoded
