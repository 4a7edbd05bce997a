"""Which layout files have: by the name that is given, else by the names of files and of their channels."""

from __future__ import annotations

import os
import re
import shlex
from dataclasses import replace
from pathlib import Path
from reprlib import repr as shown

from ..errors import InputError, did_you_mean
from .exr_format import ExrHeader
from .files import fits
from .layers import SIGNALS
from .layout import Layout
from .layout_file import read_layout
from .layouts import BMFR, FALCOR, LAYOUTS, MITSUBA, NAMES, NATIVE, OIDN, cycles
from .noisebase import NOISEBASE

MAX_DIGITS = 9  # of a number of samples
ONE_FILE = ("native", "cycles", "mitsuba")  # presets with all layers in one file


def choose(name: str | Layout, source: str | os.PathLike) -> Layout | None:
    """The layout, if it is given, or if its name or the names of the files in `source` (folder or glob) decide it;
    None: the first header decides (`find`). A name that ends in .toml is a file that describes a layout, but for a view
    layer's (cycles:NAME).

    Raises `InputError` for an unknown name, and as `read_layout` does.
    """
    if isinstance(name, Layout):
        return name
    if not isinstance(name, str):
        raise InputError(f"preset: expected the name of a layout or a .toml file, got {type(name).__name__}")
    if name.partition(":")[0] == "cycles":
        return None
    if name.endswith(".toml"):
        return read_layout(Path(name))
    if name.partition(":")[0] == NOISEBASE.name or (name == "auto" and _holds_archives(Path(source))):
        return NOISEBASE
    if name == "auto":
        return next((layout for layout in (FALCOR, BMFR, OIDN) if fits(source, layout.buffers)), None)
    if name in LAYOUTS:
        return LAYOUTS[name]
    raise InputError(f"unknown preset '{name}'{did_you_mean(name, NAMES)}: known are auto, {', '.join(NAMES)}, "
                     "or a .toml file")  # fmt: skip


def _holds_archives(source: Path) -> bool:
    """Whether `source` holds zip files and no EXR files."""
    suffixes = {path.suffix.lower() for path in source.iterdir()} if source.is_dir() else {source.suffix.lower()}
    return ".zip" in suffixes and ".exr" not in suffixes


def samples(name: str) -> int:
    """The number of samples a pixel to read: N of "noisebase:N", 1 for "noisebase". Raises `InputError`."""
    count = name.partition(":")[2] or "1"
    if not count.isdecimal() or len(count) > MAX_DIGITS or int(count) == 0:
        raise InputError(f"preset {shown(name)}: expected noisebase:N with N samples a pixel, 1 or more")
    return int(count)


def find(name: str, header: ExrHeader) -> Layout:
    """The layout of a file: "auto" detects it, "cycles:NAME" picks one of several view layers. Raises `InputError`
    where none fits."""
    return detect(header) if name == "auto" else cycles(_choose_view_layer(header, name.partition(":")[2]))


def settled(layout: Layout, header: ExrHeader) -> Layout:
    """A layout that is `like` a preset as that preset, with its own layers in place of others. Raises `InputError` as
    `find` does, and where no such preset has all layers in one file."""
    if not layout.like:
        return layout
    preset = layout.like.partition(":")[0]
    if preset not in ONE_FILE:
        raise InputError(f"preset {layout.name}: like is '{layout.like}', expected {', '.join(ONE_FILE)}")
    base = LAYOUTS[preset] if preset in LAYOUTS else find(layout.like, header)
    own = layout.demodulated | base.demodulated, layout.more_history or base.more_history
    return replace(base, layers={**base.layers, **layout.layers}, demodulated=own[0], more_history=own[1])


def detect(header: ExrHeader) -> Layout:
    """The layout whose names this file uses.

    Raises `InputError` where none fits, or where a Cycles file has several view layers.
    """
    if view_layers(header):
        return cycles(_choose_view_layer(header, ""))
    candidates = (NATIVE,) if _may_be_vrays(header) else (NATIVE, MITSUBA)
    found = {layout.name: set().union(*(layout.resolve(header, signal) for signal in SIGNALS)) for layout in candidates}
    best = max(candidates, key=lambda layout: len(found[layout.name]))  # ties go to native
    if "radiance" not in found[best.name]:
        _refuse_views(header)
        raise InputError(f"{header.path}: no known layout (presets: {', '.join(NAMES)}): no R,G,B, no indirect.R,G,B, "
                         f"no <ViewLayer>.Combined.R,G,B among {header.summary}; describe your files "
                         "(rtdenoise inspect SEQ --write my.toml)")  # fmt: skip
    return best


def _may_be_vrays(header: ExrHeader) -> bool:
    """Whether the layer `normals` may be V-Ray's, which is in the camera's space. Mitsuba calls depth `T`."""
    return "normals.X" in header.channels and not any(name.endswith(".T") for name in header.channels)


def view_layers(header: ExrHeader) -> list[str]:
    """The view layers of a Cycles file, in its order; "Composite", the compositor's result, only if it is alone."""
    pattern = re.compile(r"(?:(.+)\.)?(?:Combined|Noisy Image|Diffuse Indirect|DiffInd)\.R")
    found = dict.fromkeys(match[1] or "" for name in header.channels if (match := pattern.fullmatch(name)))
    return [layer for layer in found if layer != "Composite"] or list(found)


def _refuse_views(header: ExrHeader) -> None:
    """Raise InputError for a file of several views of a picture: `ViewLayer.Combined.left.R`."""
    pattern = re.compile(r"(?:.+\.)?(?:Combined|Noisy Image)\.([^.]+)\.R")
    if views := [match[1] for name in header.channels if (match := pattern.fullmatch(name))]:
        raise InputError(f"{header.path}: holds several views ({', '.join(views)}), as Blender's Views Format "
                         "Multi-View writes them: render with Individual, and denoise each view for itself, e.g. "
                         "'shot/*_L.exr'")  # fmt: skip


def _choose_view_layer(header: ExrHeader, wanted: str) -> str:
    found = view_layers(header)
    if not found:
        _refuse_views(header)
        raise InputError(f"{header.path}: no <ViewLayer>.Combined.R as Cycles writes it among {header.summary}")
    if wanted and wanted not in found:
        raise InputError(f"{header.path}: no view layer '{wanted}'; the file has {', '.join(found)}")
    if not wanted and len(found) > 1:
        names, example = ", ".join(found), shlex.quote(f"cycles:{found[0]}")
        raise InputError(f"{header.path}: several view layers ({names}): choose one, e.g. preset {example}")
    return wanted or found[0]
