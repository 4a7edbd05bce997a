"""What the header of an OpenEXR file says of its picture, for the header of a file that is made from it."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Mapping

import OpenEXR

from .exr_chunks import single_start
from .exr_format import ExrHeader

STRUCTURE = {  # attributes that the encoder makes itself; scan lines have no random order, as tiles may have
    "channels", "chunkCount", "lineOrder", "name", "tiles", "type", "version",
}  # fmt: skip
OF_THE_FILE = STRUCTURE | {  # and those that say nothing of a picture made from it, or are in `ExrHeader.placing`
    "compression", "dwaCompressionLevel", "multiView", "preview", "view",
    "chromaticities", "dataWindow", "displayWindow", "pixelAspectRatio",
}  # fmt: skip
CRYPTOMATTE = "cryptomatte/"  # in front of the attributes that say what its channels are


def attributes_of(header: ExrHeader, kept: Collection[str] = ()) -> dict[str, object]:
    """As `exr.read_attributes`, of a header."""
    found = _attributes(header, 0)
    picture = {
        name: value for name, value in found.items()
        if name not in OF_THE_FILE and not name.startswith(CRYPTOMATTE) and has_type(value)
    }  # fmt: skip
    mattes = {}
    for index, part in enumerate(header.parts):
        if kept and CRYPTOMATTE.encode() in part.attributes:
            mattes |= _mattes(_attributes(header, index) if index else found, kept)
    return picture | mattes


def _attributes(header: ExrHeader, index: int) -> dict[str, object]:
    """The header of one part, as OpenEXR reads it; empty where it cannot."""
    try:
        return OpenEXR.File(io.BytesIO(single_start(header, index)), header_only=True).header()
    except (RuntimeError, ValueError, ArithmeticError):  # ArithmeticError: a rational over 0
        return {}


def _mattes(attributes: Mapping[str, object], kept: Collection[str]) -> dict[str, object]:
    """The attributes `cryptomatte/KEY/...` of each KEY whose `name` is that of some channels, as `NAME00.r`."""
    layers = {re.sub(r"\d\d\.[^.]+$", "", channel) for channel in kept}
    names = {key: value for key, value in attributes.items() if re.fullmatch(f"{CRYPTOMATTE}[^/]+/name", key)}
    starts = tuple(key.removesuffix("name") for key, name in names.items() if name in layers)
    return {key: value for key, value in attributes.items() if key.startswith(starts) and has_type(value)}


def has_type(value: object) -> bool:
    """Whether OpenEXR's Python can write an attribute: of an empty list it does not know the type."""
    return not isinstance(value, list) or bool(value)
