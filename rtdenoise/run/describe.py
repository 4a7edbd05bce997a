"""Describe files that no preset knows: `rtdenoise inspect SEQ --write my.toml`.

Names say which channels are which layer (`data/names.py`). What their numbers mean is measured: the convention of
motion vectors by warping one frame to the next (`conventions`), and from which depth on nothing was hit.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..data.layout import Layout, Rule
from ..data.layout_file import layout_text
from ..data.names import guess
from ..data.sequences import open_sequence
from ..errors import INSTALL_TORCH, InputError
from ..files import write_atomically
from .inspect import choose_pairs

if TYPE_CHECKING:
    from ..frame import Frame
    from .conventions import Reading, Verdict

NEARLY = 0.05  # the length of most normals is as far from 1 at most
MANY, FAR, ENDLESS = 8, 1e3, 1e6  # pixels of the greatest depth, and times the median depth: nothing was hit there
BETTER = 0.9  # times the error of another reading
MOTIONS = "motion", "motion_next"
DIVIDED = "; where 0.5 is no motion and 1 the greatest, scale is twice that number of pixels"
OTHER_UNITS = 0.5, 0.7, 1.4, 2.0  # times one of those known, each of which is twice the one before
GREY = 0.5  # may stand for no motion
SCALE_OF = {  # unit of a `conventions.Reading` -> of a rule
    "UV": "uv", "NDC": "ndc", "2 UV": "2uv", "pixels": 1.0, "double": 0.5, "half": 2.0
}  # fmt: skip


def write_description(source: str | os.PathLike, path: Path, allow_gaps: bool = False) -> None:
    """Write the layout of a sequence to `path`, a TOML file for `--preset`, with a comment at each layer that was
    measured.

    Raises `InputError` where `path` exists, or as `names.guess` and `open_sequence` do.
    """
    if path.suffix != ".toml":
        raise InputError(f"--write {path}: expected a name that ends in .toml, as presets of your own have")
    if path.exists():
        raise InputError(f"--write {path}: exists; name another file, or remove it")
    described, notes = describe(source, allow_gaps)
    text = layout_text(replace(described, name=path.stem), notes)
    try:
        write_atomically(path, text.encode())
    except OSError as error:
        raise InputError(f"--write {path}: cannot be written: {error.strerror}") from None


def describe(source: str | os.PathLike, allow_gaps: bool = False) -> tuple[Layout, dict[str, str]]:
    """The layout of a sequence, and a note on each layer that was measured."""
    layout = guess(source)
    sequence = open_sequence(source, preset=layout, allow_gaps=allow_gaps)
    chosen = choose_pairs(sequence.numbers)
    frames = {i: sequence.read(i) for i in {i for pair in chosen for i in pair} or {0}}
    layers, notes = dict(layout.layers), dict[str, str]()
    if "normal" in layers:
        layers["normal"] = (_decoded(layers["normal"][0], [*frames.values()]),)
    if "depth" in layers:
        far, notes["depth"] = _far([*frames.values()])
        layers["depth"] = (replace(layers["depth"][0], miss=far),)
    if "motion" in layers or "motion_next" in layers:
        layers |= _measured(layers, [(frames[a], frames[b]) for a, b in chosen], notes)
    return replace(layout, layers=layers), notes


def _decoded(rule: Rule, frames: list[Frame]) -> Rule:
    """The rule of normals, which some renderers store as n / 2 + 1/2."""
    stored = np.concatenate([frame.normal.reshape(3, -1) for frame in frames], axis=1)
    lengths = np.linalg.norm(2 * stored - 1, axis=0)
    unit = np.mean(np.abs(lengths - 1) < NEARLY)
    plain = np.mean(np.abs(np.linalg.norm(stored, axis=0) - 1) < NEARLY)
    return replace(rule, offset=0.5, scale=2.0) if np.nanmin(stored) >= 0 and unit > plain else rule


def _far(frames: list[Frame]) -> tuple[float, str]:
    """From which depth on nothing was hit, where renderers write 1e10, 1e30 or the greatest half, and a note."""
    depths = np.concatenate([frame.depth[frame.depth > 0] for frame in frames])
    depths = depths[np.isfinite(depths)]
    if not depths.size:
        return np.inf, "not confirmed: nothing is above 0"
    near, most = np.median(depths), depths.max()
    if np.count_nonzero(depths == most) >= MANY and most > FAR * near:
        # Depth that is averaged over samples lies in between at edges.
        return 10.0 ** np.floor(np.log10(most) - 1) if most > ENDLESS * near else float(f"{0.99 * most:.2g}"), (
            f"{most:.4g} is where nothing was hit"
        )
    told = f"from {depths.min():.4g} to {most:.4g}"
    return np.inf, f"{told}: not distances from the camera?" if most <= 1 else told


def _measured(
    layers: Mapping[str, tuple[Rule, ...]], pairs: list[tuple[Frame, Frame]], notes: dict[str, str]
) -> dict[str, tuple[Rule, ...]]:
    """The rules of motion by the convention that explains how pictures change; a note on each goes into `notes`."""
    fields = {layer: layer for layer in MOTIONS if layer in layers}  # and the field that the files hold as this layer
    if find_spec("torch") is None:
        notes |= dict.fromkeys(fields, f"not confirmed: that takes PyTorch; {INSTALL_TORCH}")
        return {}
    import torch

    from .conventions import check_motion

    tensors = [(before.map(torch.from_numpy), now.map(torch.from_numpy)) for before, now in pairs]
    if len(fields) == 2 and (best := check_motion(tensors).best) and best.source == "motion_next":
        fields = {"motion": "motion_next", "motion_next": "motion"}
    found = {}
    for layer, field in fields.items():
        grey = _is_grey([getattr(frame, field) for pair in pairs for frame in pair])
        offset, verdict = _judged(tensors, layer, field, grey)
        rule = replace(layers[field][0], offset=offset)
        found[layer] = (_read_as(rule, verdict.best) if verdict.status == "wrong" else rule,)
        notes[layer] = _told(verdict) + (DIVIDED if grey and not verdict.best else "")
        if verdict.best and fields == {"motion": "motion"}:
            other = check_motion(_as_motion(tensors, "motion_next", field, offset))
            if _error(other) < BETTER * _error(verdict):
                notes[layer] += "; they seem to lead to the next frame: render those from the frame before if you can"
    return found


def _judged(pairs: list[tuple[Frame, Frame]], layer: str, field: str, grey: bool) -> tuple[float, Verdict]:
    """What stands for no motion in a field, and the verdict on it."""
    from .conventions import check_motion

    verdicts = {offset: check_motion(_as_motion(pairs, layer, field, offset)) for offset in (0.0, GREY)}
    if not grey:
        offset = GREY if _error(verdicts[GREY]) < BETTER * _error(verdicts[0.0]) else 0.0
        return offset, verdicts[offset]
    verdict = verdicts[GREY]
    others = (check_motion(_as_motion(pairs, layer, field, GREY, unit)) for unit in OTHER_UNITS)
    if any(_error(other) < BETTER * _error(verdict) for other in others):
        verdict = replace(verdict, status="ambiguous", message="its unit is none of those known", best=None)
    return GREY, verdict


def _as_motion(
    pairs: list[tuple[Frame, Frame]], layer: str, field: str, offset: float, unit: float = 1.0
) -> list[tuple[Frame, Frame]]:  # fmt: skip
    """Pairs for `check_motion` in which a field of the files stands for motion; for `motion_next` time is reversed."""
    ways = pairs if layer == "motion" else [(now, before) for before, now in pairs]
    return [(a, replace(b, motion=unit * (getattr(b, field) - offset), motion_next=None)) for a, b in ways]


def _is_grey(fields: list[np.ndarray]) -> bool:
    """Whether all of the motion lies in [0, 1], and most of it near the middle."""
    stored = np.concatenate([field.reshape(2, -1) for field in fields], axis=1) if fields else np.zeros((2, 1))
    middle = np.median(stored, axis=1)
    return bool(stored.min() >= 0 and stored.max() <= 1 and (np.abs(middle - GREY) < GREY / 2).all())


def _error(verdict: Verdict) -> float:
    """Of the best reading, as a share of that without motion."""
    return verdict.errors["best"] / verdict.errors["no motion"] if verdict.best else np.inf


def _read_as(rule: Rule, reading: Reading) -> Rule:
    """A rule without conversion as the reading has it."""
    channels = rule.channels[::-1] if reading.swapped else rule.channels
    return replace(rule, channels=channels, signs=reading.signs, scale=SCALE_OF[reading.unit])


def _told(verdict: Verdict) -> str:
    if verdict.status == "ambiguous":
        return f"not confirmed: {verdict.message}"
    compared = f"error {verdict.errors['best']:.4f}, without motion {verdict.errors['no motion']:.4f}"
    told = f"measured: it explains how {verdict.feature} changes ({compared})"
    tied = [reading.formula for reading in verdict.tied if reading.source == "motion"]
    return f"{told}; as well does {', '.join(tied)} of what is stored" if tied else told
