"""Describe files that no preset knows, or whose motion is not as its says: `rtdenoise inspect SEQ --write my.toml`.

Names say which channels are which layer (`data/names.py`). What their numbers mean is measured: motion vectors by
warping one frame to the next (`vectors`), and by their values depth where nothing was hit, and normals.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..data.layout import Layout, Rule
from ..data.layout_file import layout_text, parse_layout
from ..data.names import GUESSED, guess
from ..data.opening import open_sequence
from ..data.sequences import Sequence
from ..errors import INSTALL_TORCH, InputError, printable
from ..files import write_atomically
from .inspect import choose_pairs
from .normals import are_encoded

if TYPE_CHECKING:
    from ..frame import Frame
    from .vectors import Meaning

MANY, FAR, ENDLESS = 8, 1e3, 1e6  # pixels of the greatest depth, and times the median depth: nothing was hit there
OFTEN = 0.01  # share of pixels with the greatest depth, of which a note tells
BETTER = 0.95  # times the error of another reading
MOTIONS = "motion", "motion_next"
CYCLES = "cycles"
STORED = "measured: stored as n / 2 + 1/2; "
SPACE = "not measured: world space is right, the camera's is not"


def write_description(
    source: str | os.PathLike, path: Path, signal: str = "color", allow_gaps: bool = False
) -> dict[str, str]:
    """Write the layout of a sequence to `path`, a TOML file for `--preset`, with a comment at each layer that was
    measured. Returns these comments by layer.

    Raises `InputError` where `path` exists, or as `names.guess` and `open_sequence` do.
    """
    if path.suffix != ".toml" or not str(path).isprintable() or str(path).startswith("cycles:"):
        raise InputError(f"--write {path}: expected a name that ends in .toml, as presets of your own have")
    if path.exists():
        raise InputError(f"--write {path}: exists; name another file, or remove it")
    if not path.parent.is_dir():
        raise InputError(f"--write {path}: there is no folder {path.parent}")
    described, notes = describe(source, signal, allow_gaps)
    notes = {layer: printable(told) for layer, told in notes.items()}
    text = layout_text(replace(described, name=path.stem), notes)
    parse_layout(text, path)  # refuses what a name holds and the format does not
    write_atomically(path, text.encode())
    return notes


def describe(
    source: str | os.PathLike, signal: str = "color", allow_gaps: bool = False
) -> tuple[Layout, dict[str, str]]:
    """The layout of a sequence, and a note on each layer that was measured, or whose files are in doubt. Where
    motion in frames of Cycles is not as its preset says, as behind a fisheye, that is the preset, mended."""
    if mended := _mended(source, signal, allow_gaps):
        return mended
    doubts = dict[str, str]()
    layout = guess(source, signal, doubts)
    sequence = open_sequence(source, signal=signal, preset=layout, allow_gaps=allow_gaps)
    chosen = choose_pairs(sequence.numbers, sequence.size)
    frames = {i: sequence.read(i) for i in {i for pair in chosen for i in pair} or {0}}
    layers, buffers, notes = dict(layout.layers), dict(layout.buffers), dict[str, str]()
    if "normal" in layers:
        rule = _decoded(layers["normal"][0], [*frames.values()])
        layers["normal"], notes["normal"] = (rule,), f"{STORED if rule.offset else ''}their space is {SPACE}"
    if "depth" in layers:
        rule, notes["depth"] = _distances(layers["depth"][0], [*frames.values()])
        layers["depth"] = (rule,)
    fields = {layer: layers[layer][0] for layer in MOTIONS if layer in layers}
    if fields and find_spec("torch") is None:
        notes |= dict.fromkeys(fields, f"not measured: that takes PyTorch; {INSTALL_TORCH}")
    elif fields:
        found = _measured(fields, [(frames[a], frames[b]) for a, b in chosen], notes)
        for field in fields:
            del layers[field]
            buffers.pop(field, None)
        for layer, (field, rule) in found.items():
            if field in layout.buffers:
                rule = replace(rule, channels=tuple(layer + name.removeprefix(field) for name in rule.channels))
                buffers[layer] = layout.buffers[field]
            layers[layer] = (rule,)
    notes |= {layer: "; ".join(filter(None, [notes.get(layer), told])) for layer, told in doubts.items()}
    return replace(layout, layers=layers, buffers=buffers), notes


def _mended(
    source: str | os.PathLike, signal: str, allow_gaps: bool
) -> tuple[Layout, dict[str, str]] | None:
    """`describe` for frames of Cycles whose motion is not as its preset says; None for others. Takes PyTorch."""
    try:
        sequence = open_sequence(source, signal=signal, allow_gaps=allow_gaps)
    except InputError:
        return None
    chosen, notes = choose_pairs(sequence.numbers, sequence.size), dict[str, str]()
    if sequence.layout.name != CYCLES or not (chosen and sequence.has("motion")) or find_spec("torch") is None:
        return None
    if not _is_wrong(_pairs(sequence, chosen)):
        return None
    fields = {m: replace(r, signs=(1, 1)) for m, r in sequence.available.items() if m in MOTIONS}
    stored = replace(sequence.layout, layers={**sequence.layout.layers, **{m: (r,) for m, r in fields.items()}})
    sequence = open_sequence(source, signal=signal, preset=stored, allow_gaps=allow_gaps)
    found = _measured(fields, _pairs(sequence, chosen), notes)
    return Layout(GUESSED, {layer: (rule,) for layer, (_, rule) in found.items()}, like=CYCLES), notes


def _is_wrong(pairs: list[tuple[Frame, Frame]]) -> bool:
    """Whether motion in these frames has another convention."""
    import torch

    from .conventions import check_motion

    return check_motion([tuple(x.map(torch.from_numpy) for x in pair) for pair in pairs]).status == "wrong"


def _pairs(sequence: Sequence, chosen: list[tuple[int, int]]) -> list[tuple[Frame, Frame]]:
    """Pairs of frames by their indices."""
    frames = {i: sequence.read(i) for i in {i for pair in chosen for i in pair}}
    return [(frames[a], frames[b]) for a, b in chosen]


def _decoded(rule: Rule, frames: list[Frame]) -> Rule:
    """The rule of normals, which some renderers store as n / 2 + 1/2."""
    return replace(rule, offset=0.5, scale=2.0) if are_encoded(frames) else rule


def _distances(rule: Rule, frames: list[Frame]) -> tuple[Rule, str]:
    """The rule of depth, with that from which on nothing was hit, where renderers write 1e10, 1e30 or the greatest
    half, and a note."""
    stored = np.concatenate([frame.depth.ravel() for frame in frames]).astype(np.float64)
    stored = stored[np.isfinite(stored) & (stored != 0)]
    if not stored.size:
        return rule, "not measured: it is 0 everywhere"
    sizes = np.abs(stored)  # 1e10 may stand for nothing among negative depths, too
    most = sizes.max()
    nearer = sizes < most
    if np.median(stored[nearer] if nearer.any() else stored) < 0:
        rule, stored = replace(rule, signs=(-1,)), -stored
    hit, share = stored[nearer], 1 - nearer.mean()
    near = np.median(hit) if hit.size else most
    if share * stored.size >= MANY and most > FAR * near:
        # Depth that is averaged over samples lies in between at edges.
        miss = 10.0 ** np.floor(np.log10(most) - 1) if most > ENDLESS * near else 0.99 * most
        return replace(rule, miss=float(f"{miss:.6g}")), f"{most:.4g} is where nothing was hit"
    told = f"from {stored.min():.4g} to {most:.4g}"
    if share > OFTEN and hit.size:
        told += f", in {share:.0%} of the pixels exactly that: if nothing was hit there, set miss below it"
    return rule, told


def _measured(
    fields: dict[str, Rule], pairs: list[tuple[Frame, Frame]], notes: dict[str, str]
) -> dict[str, tuple[str, Rule]]:
    """Layer -> the field that it is read from, and its rule, as motion explains how pictures change. A field that is
    the same everywhere is left out where the other one tells of movement. A note on each goes into `notes`."""
    import torch

    from .vectors import fit

    tensors = [(before.map(torch.from_numpy), now.map(torch.from_numpy)) for before, now in pairs]
    ways = {"motion": tensors, "motion_next": [(now, before) for before, now in tensors]}
    found = {
        (layer, field): fit(way, [getattr(frame, field) for _, frame in way])
        for layer, way in ways.items() for field in fields
    }  # fmt: skip
    order, errors = _ordered(fields, found, pairs), {pair: meaning.error for pair, meaning in found.items()}
    rules = {}
    for layer, field in order.items():
        meaning = found[layer, field]
        rules[layer] = field, _read_as(fields[field], meaning)
        notes[layer] = meaning.told if meaning.confirmed else f"not confirmed: {meaning.told}"
    for field, layer in zip(fields.keys() - order.values(), fields.keys() - order.keys(), strict=False):
        notes[layer] = f"{', '.join(fields[field].channels)} left out: {found[field, field].told}"
    if order == {"motion": "motion"} and errors["motion_next", "motion"] < BETTER * errors["motion", "motion"]:
        notes["motion"] += "; they seem to lead to the next frame: render those from the frame before if you can"
    return rules


def _ordered(
    fields: Iterable[str], found: dict[tuple[str, str], Meaning], pairs: list[tuple[Frame, Frame]]
) -> dict[str, str]:
    """Layer -> the field that it is read from, whatever their names say."""
    order = {layer: layer for layer in fields}
    telling = [field for field in fields if not _is_even(field, pairs)]
    if len(order) == 2 and len(telling) == 1 and any(found[layer, telling[0]].confirmed for layer in MOTIONS):
        order = {telling[0]: telling[0]}
    if "motion_next" not in order:
        return order
    crossed = dict(zip(MOTIONS, MOTIONS[::-1], strict=True)) if len(order) == 2 else {"motion": "motion_next"}
    named, other = (sum(found[pair].error for pair in ways.items()) for ways in (order, crossed))
    return crossed if other < BETTER * named else order


def _is_even(field: str, pairs: list[tuple[Frame, Frame]]) -> bool:
    """Whether it is the same in all pixels of all frames."""
    stored = [getattr(frame, field) for pair in pairs for frame in pair]
    return all((pixels == stored[0][..., :1, :1]).all() for pixels in stored)


def _read_as(rule: Rule, meaning: Meaning) -> Rule:
    """A rule without conversion as the meaning has it."""
    channels = rule.channels[::-1] if meaning.swapped else rule.channels
    return replace(rule, channels=channels, signs=meaning.signs, scale=meaning.scale, offset=meaning.offset)
