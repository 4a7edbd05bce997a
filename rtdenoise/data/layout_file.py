"""Layouts of one's own, from a TOML file: the channels, and files, that make each layer.

    name = "tracer"
    like = "cycles"                      # what is not described here is as in this preset; leave out for other programs
    demodulated = ["indirect"]           # signals that are already divided by the albedo
    more_history = true                  # `Frame.more_history`

    [color]
    channels = ["R", "G", "B"]
    file = "beauty/{frame}.exr"          # only where each layer has a file of its own; see files.py for patterns

    [motion]
    channels = ["velocity.X", "velocity.Y"]
    signs = [1, -1]                      # this project's: previous - current, y down
    scale = "uv"                         # fractions of the picture; "ndc", "2uv": of half, of twice it; or pixels
    offset = 0.5                         # what stands for 0; default 0
    file = "velocity/{frame}.exr"

    [depth]
    channels = ["Z"]
    miss = 1e9                           # nothing was hit from this distance on, whatever the sign
    file = "depth/{frame}.exr"

Layers are those of the native layout. There is no `radiance`: a file has `color`, `indirect` or both. `large` and
`small` make the components of a Metropolis render.
"""

from __future__ import annotations

import json
import math
import re
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path, PurePosixPath
from reprlib import repr

from ..errors import InputError, did_you_mean
from ..files import read_text
from .layers import LAYERS, SIGNALS
from .layout import SCALES, Layout, Rule, with_components

COUNTS = {name: layer.channels for name, layer in LAYERS.items()} | {"indirect_albedo": 3}
KEYS = ("channels", "signs", "scale", "offset", "miss", "file")


def read_layout(path: Path) -> Layout:
    """Read and check a layout file. Raises `InputError`, on one line, for whatever does not fit."""
    return parse_layout(read_text(path), path)


def parse_layout(text: str, path: Path) -> Layout:
    """As `read_layout`, of its text."""
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, or an integer of thousands of digits
        raise InputError(f"{path}: not valid TOML: {error}") from None
    name = document.pop("name", path.stem)
    demodulated, more_history = document.pop("demodulated", []), document.pop("more_history", False)
    like = document.pop("like", "")
    if not isinstance(name, str):
        raise InputError(f"{path}: name is {repr(name)}, expected a string")
    if not isinstance(demodulated, list) or not all(signal in list(SIGNALS) for signal in demodulated):
        raise InputError(f"{path}: demodulated is {repr(demodulated)}, expected a list of {', '.join(SIGNALS)}")
    if not isinstance(more_history, bool):
        raise InputError(f"{path}: more_history is {repr(more_history)}, expected true or false")
    if not isinstance(like, str):
        raise InputError(f"{path}: like is {repr(like)}, expected the name of a preset")
    layers = {layer: _rule(path, layer, table) for layer, table in document.items()}
    if not like and not layers.keys() & SIGNALS.keys():
        raise InputError(f"{path}: describes no signal; expected a table [color] or [indirect]")
    files = {layer: table["file"] for layer, table in document.items() if "file" in table}
    if files and like:
        raise InputError(f"{path}: [{next(iter(files))}] has a 'file', which does not go with like = {repr(like)}")
    if files and (without := [layer for layer in layers if layer not in files]):
        raise InputError(f"{path}: [{without[0]}] has no 'file', [{next(iter(files))}] has one; give all layers a "
                         "file, or none where one file holds all of them")  # fmt: skip
    return Layout(
        name,
        with_components({layer: (rule.of_buffer(layer) if files else rule,) for layer, rule in layers.items()}),
        demodulated=frozenset(demodulated),
        buffers={layer: (pattern,) for layer, pattern in files.items()},
        more_history=more_history,
        like=like,
    )


def layout_text(layout: Layout, notes: Mapping[str, str]) -> str:
    """A layout, whose layers have one rule each, as the text of a file that `read_layout` reads. `notes`: a line about
    a layer, also about one that is not described, for whoever edits it."""
    lines = [f"name = {_text(layout.name)}", *(["more_history = true"] if layout.more_history else [])]
    lines += [f"like = {_text(layout.like)}"] if layout.like else []
    for layer, (rule,) in layout.layers.items():
        if layer not in COUNTS:  # made of others
            continue
        file, *_ = layout.buffers.get(layer, ("",))
        channels = [name.removeprefix(f"{layer}.") if file else name for name in rule.channels]
        lines += ["", f"[{layer}]", f"channels = {_text(channels)}"]
        lines += [f"signs = {_text(rule.signs)}"] if min(rule.signs) < 0 else []
        lines += [f"scale = {_text(rule.scale)}"] if rule.scale != 1 else []
        lines += [f"offset = {_text(rule.offset)}"] if rule.offset else []
        lines += [f"miss = {rule.miss:g}"] if math.isfinite(rule.miss) else []
        lines += [f"file = {_text(file)}"] if file else []
        lines += [f"# {notes[layer]}"] if layer in notes else []
    if absent := [f"# {layer}: {told}" for layer, told in notes.items() if layer not in layout.layers]:
        lines += ["", *absent]
    return "\n".join(lines) + "\n"


def _text(value: object) -> str:
    """As TOML has it: without JSON's pairs of escapes, and with one for DEL."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _rule(path: Path, layer: str, table: object) -> Rule:
    label = f"{path}: [{layer}]"
    if layer not in COUNTS:
        raise InputError(f"{path}: unknown layer '{layer}'{did_you_mean(layer, COUNTS)}; known are {', '.join(COUNTS)}")
    if not isinstance(table, dict):
        raise InputError(f"{path}: {layer} is {repr(table)}, expected a table [{layer}]")
    for key in table:
        if key not in KEYS:
            raise InputError(f"{label} unknown key '{key}'{did_you_mean(key, KEYS)}; known are {', '.join(KEYS)}")
    count = COUNTS[layer]
    channels = table.get("channels")
    if not isinstance(channels, list) or len(channels) != count or not all(isinstance(c, str) for c in channels):
        raise InputError(f"{label} channels is {repr(channels)}, expected {count} channel name{'s' * (count > 1)}")
    signs = table.get("signs", [1] * count)
    if not isinstance(signs, list) or len(signs) != count or not all(_is_number(s) and s in (1, -1) for s in signs):
        raise InputError(f"{label} signs is {repr(signs)}, expected {count} times 1 or -1")
    scale, offset = table.get("scale", "pixels"), table.get("offset", 0.0)
    scale = 1.0 if scale == "pixels" else scale
    motion = layer.startswith("motion")
    named = motion and scale in list(SCALES)
    if not named and not (_is_number(scale) and 0 < scale < math.inf):
        raise InputError(f"{label} scale is {repr(scale)}, expected a number above 0, for motion also 'pixels', 'uv', "
                         "'ndc' or '2uv'")  # fmt: skip
    if not _is_number(offset) or not math.isfinite(offset):
        raise InputError(f"{label} offset is {repr(offset)}, expected a number")
    if (scale != 1 or offset) and not (motion or layer == "normal"):
        raise InputError(f"{label} scale and offset are for motion and normal only")
    miss = table.get("miss", float("inf"))
    if not _is_number(miss) or not miss > 0 or ("miss" in table and layer != "depth"):
        raise InputError(f"{label} miss is {repr(miss)}, expected a number above 0, for depth only")
    file = table.get("file", "{frame}")
    if not isinstance(file, str) or not _is_pattern(file):
        raise InputError(f"{label} file is {repr(file)}, expected a pattern in the sequence's folder with one "
                         "{frame}, at most one {spp}, and * for anything")  # fmt: skip
    scale = scale if named else float(scale)
    return Rule(tuple(channels), tuple(int(s) for s in signs), float(miss), scale, float(offset))


def _is_number(value: object) -> bool:
    """Whether it is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return isinstance(value, float) or abs(value) < sys.float_info.max


def _is_pattern(file: str) -> bool:
    """Whether it is a relative path with one {frame} and at most one {spp}."""
    placeholders = re.findall(r"\{\w*\}", file)
    path = PurePosixPath(file)
    return (
        placeholders.count("{frame}") == 1
        and set(placeholders) <= {"{frame}", "{spp}"}
        and len(placeholders) == len(set(placeholders))
        and not path.is_absolute()
        and ".." not in path.parts
        and file.isprintable()
    )
