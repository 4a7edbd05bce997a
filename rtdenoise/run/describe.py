"""Describe files that no preset knows: `rtdenoise inspect SEQ --write my.toml`.

Names say which channels are which layer (`data/names.py`). What their numbers mean is measured: motion vectors by
warping one frame to the next (`vectors`), and by their values depth where nothing was hit, and normals.
"""

from __future__ import annotations

import os
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..data.layout import Layout, Rule
from ..data.layout_file import layout_text, parse_layout
from ..data.names import guess
from ..data.sequences import open_sequence
from ..errors import INSTALL_TORCH, InputError
from ..files import write_atomically
from .inspect import choose_pairs

if TYPE_CHECKING:
    from ..frame import Frame
    from .vectors import Meaning

NEARLY = 0.05  # the length of most normals is as far from 1 at most
MANY, FAR, ENDLESS = 8, 1e3, 1e6  # pixels of the greatest depth, and times the median depth: nothing was hit there
OFTEN = 0.01  # share of pixels with the greatest depth, of which a note tells
BETTER = 0.95  # times the error of another reading
MOTIONS = "motion", "motion_next"
SPACE = "not measured: world space is right, the camera's is not"


def write_description(source: str | os.PathLike, path: Path, signal: str = "color", allow_gaps: bool = False) -> None:
    """Write the layout of a sequence to `path`, a TOML file for `--preset`, with a comment at each layer that was
    measured.

    Raises `InputError` where `path` exists, or as `names.guess` and `open_sequence` do.
    """
    if path.suffix != ".toml" or not str(path).isprintable() or str(path).startswith("cycles:"):
        raise InputError(f"--write {path}: expected a name that ends in .toml, as presets of your own have")
    if path.exists():
        raise InputError(f"--write {path}: exists; name another file, or remove it")
    if not path.parent.is_dir():
        raise InputError(f"--write {path}: there is no folder {path.parent}")
    described, notes = describe(source, signal, allow_gaps)
    text = layout_text(replace(described, name=path.stem), notes)
    parse_layout(text, path)  # refuses what a name holds and the format does not
    write_atomically(path, text.encode())


def describe(
    source: str | os.PathLike, signal: str = "color", allow_gaps: bool = False
) -> tuple[Layout, dict[str, str]]:
    """The layout of a sequence, and a note on each layer that was measured."""
    layout = guess(source, signal)
    sequence = open_sequence(source, signal=signal, preset=layout, allow_gaps=allow_gaps)
    chosen = choose_pairs(sequence.numbers)
    frames = {i: sequence.read(i) for i in {i for pair in chosen for i in pair} or {0}}
    layers, notes = dict(layout.layers), dict[str, str]()
    if "normal" in layers:
        layers["normal"], notes["normal"] = (_decoded(layers["normal"][0], [*frames.values()]),), SPACE
    if "depth" in layers:
        rule, notes["depth"] = _distances(layers["depth"][0], [*frames.values()])
        layers["depth"] = (rule,)
    fields = {layer: layers[layer][0] for layer in MOTIONS if layer in layers}
    if fields and find_spec("torch") is None:
        notes |= dict.fromkeys(fields, f"not measured: that takes PyTorch; {INSTALL_TORCH}")
    elif fields:
        layers |= _measured(fields, [(frames[a], frames[b]) for a, b in chosen], notes)
    return replace(layout, layers=layers), notes


def _decoded(rule: Rule, frames: list[Frame]) -> Rule:
    """The rule of normals, which some renderers store as n / 2 + 1/2."""
    stored = np.concatenate([frame.normal.reshape(3, -1) for frame in frames], axis=1)
    unit, plain = (np.mean(np.abs(np.linalg.norm(n, axis=0) - 1) < NEARLY) for n in (2 * stored - 1, stored))
    return replace(rule, offset=0.5, scale=2.0) if np.mean(stored < -NEARLY) < NEARLY and unit > plain else rule


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
) -> dict[str, tuple[Rule, ...]]:
    """The rules of motion as it explains how pictures change; a note on each goes into `notes`."""
    import torch

    from .vectors import fit

    tensors = [(before.map(torch.from_numpy), now.map(torch.from_numpy)) for before, now in pairs]
    ways = {"motion": tensors, "motion_next": [(now, before) for before, now in tensors]}
    found = {
        (layer, field): fit(way, [getattr(frame, field) for _, frame in way])
        for layer, way in ways.items() for field in fields
    }  # fmt: skip
    order = dict(zip(MOTIONS, MOTIONS, strict=True))
    if len(fields) == 2:
        crossed = dict(zip(MOTIONS, MOTIONS[::-1], strict=True))
        named, other = (sum(found[pair].error for pair in ways.items()) for ways in (order, crossed))
        order = crossed if other < BETTER * named else order
    rules = {}
    for layer in fields:
        meaning = found[layer, order[layer]]
        rules[layer] = (_read_as(fields[order[layer]], meaning),)
        notes[layer] = meaning.told if meaning.confirmed else f"not confirmed: {meaning.told}"
    if [*fields] == ["motion"]:
        back, forth = (found[layer, "motion"].error for layer in MOTIONS)
        if forth < BETTER * back:
            notes["motion"] += "; they seem to lead to the next frame: render those from the frame before if you can"
    return rules


def _read_as(rule: Rule, meaning: Meaning) -> Rule:
    """A rule without conversion as the meaning has it."""
    channels = rule.channels[::-1] if meaning.swapped else rule.channels
    return replace(rule, channels=channels, signs=meaning.signs, scale=meaning.scale, offset=meaning.offset)
