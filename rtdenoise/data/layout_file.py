"""Layouts of one's own, from a TOML file: the channels, and files, that make each layer.

    name = "tracer"
    demodulated = ["indirect"]           # signals that are already divided by the albedo

    [color]
    channels = ["R", "G", "B"]
    file = "beauty/{frame}.exr"          # only where each layer has a file of its own; see files.py for patterns

    [motion]
    channels = ["velocity.X", "velocity.Y"]
    signs = [1, -1]                      # this project's: previous - current, y down
    scale = "uv"                         # fractions of the picture instead of "pixels"
    file = "velocity/{frame}.exr"

    [depth]
    channels = ["Z"]
    miss = 1e9                           # nothing was hit from this distance on
    file = "depth/{frame}.exr"

Layers are those of the native layout. There is no `radiance`: a file has `color`, `indirect` or both.
"""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path

from ..errors import InputError
from .layers import LAYERS, OLD_NAMES, SIGNALS
from .layout import SCALES, Layout, Rule

COUNTS = {name: layer.channels for name, layer in LAYERS.items()} | {"indirect_albedo": 3}
KEYS = ("channels", "signs", "scale", "miss", "file")


def read_layout(path: Path) -> Layout:
    """Read and check a layout file. Raises `InputError`, on one line, for whatever does not fit."""
    try:
        document = tomllib.loads(path.read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None
    name = document.pop("name", path.stem)
    demodulated = document.pop("demodulated", [])
    if not isinstance(name, str):
        raise InputError(f"{path}: name is {name!r}, expected a string")
    if not isinstance(demodulated, list) or not all(signal in SIGNALS for signal in demodulated):
        raise InputError(f"{path}: demodulated is {demodulated!r}, expected a list of {', '.join(SIGNALS)}")
    tables = {OLD_NAMES.get(layer, layer): table for layer, table in document.items()}
    layers = {layer: _rule(path, layer, table) for layer, table in tables.items()}
    if not layers.keys() & SIGNALS.keys():
        raise InputError(f"{path}: describes no signal; expected a table [color] or [indirect]")
    files = {layer: table["file"] for layer, table in tables.items() if "file" in table}
    if files and (without := [layer for layer in layers if layer not in files]):
        raise InputError(f"{path}: [{without[0]}] has no 'file', [{next(iter(files))}] has one; give all layers a "
                         "file, or none where one file holds all of them")  # fmt: skip
    return Layout(
        name,
        {layer: (_prefixed(rule, layer) if files else rule,) for layer, rule in layers.items()},
        demodulated=frozenset(demodulated),
        buffers={layer: (pattern,) for layer, pattern in files.items()},
    )


def _rule(path: Path, layer: str, table: object) -> Rule:
    label = f"{path}: [{layer}]"
    if layer not in COUNTS:
        raise InputError(f"{path}: unknown layer '{layer}'{_near(layer, COUNTS)}; known are {', '.join(COUNTS)}")
    if not isinstance(table, dict):
        raise InputError(f"{path}: {layer} is {table!r}, expected a table [{layer}]")
    for key in table:
        if key not in KEYS:
            raise InputError(f"{label} unknown key '{key}'{_near(key, KEYS)}; known are {', '.join(KEYS)}")
    count = COUNTS[layer]
    channels = table.get("channels")
    if not isinstance(channels, list) or len(channels) != count or not all(isinstance(c, str) for c in channels):
        raise InputError(f"{label} channels is {channels!r}, expected {count} channel name{'s' if count > 1 else ''}")
    signs = table.get("signs", [1] * count)
    if not isinstance(signs, list) or len(signs) != count or not all(s in (1, -1) for s in signs):
        raise InputError(f"{label} signs is {signs!r}, expected {count} times 1 or -1")
    scale = table.get("scale", "pixels")
    if scale not in SCALES or (scale != "pixels" and not layer.startswith("motion")):
        raise InputError(f"{label} scale is {scale!r}, expected {' or '.join(map(repr, SCALES))}, for motion only")
    miss = table.get("miss", float("inf"))
    if not isinstance(miss, int | float) or ("miss" in table and layer != "depth"):
        raise InputError(f"{label} miss is {miss!r}, expected a number, for depth only")
    file = table.get("file", "{frame}")
    if not isinstance(file, str) or "{frame}" not in file or Path(file).is_absolute():
        raise InputError(f"{label} file is {file!r}, expected a pattern in the sequence's folder with {{frame}} in it")
    return Rule(tuple(channels), tuple(int(s) for s in signs), float(miss), scale)


def _prefixed(rule: Rule, buffer: str) -> Rule:
    return Rule(tuple(f"{buffer}.{name}" for name in rule.channels), rule.signs, rule.miss, rule.scale)


def _near(name: str, known) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f" (did you mean '{near[0]}'?)" if near else ""
