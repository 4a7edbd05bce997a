"""Inspect a sequence before denoising: its layers, their use, and the convention of its motion vectors. In words:
`inspect_text`."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

from ..data.layout import Rule
from ..data.opening import open_sequence
from ..data.sequences import DEFAULT_LAYERS, Sequence
from ..frame import Frame
from ..sanitise import faults
from .choice import with_region
from .normals import told_of_normals
from .plan import Plan, make_plan
from .same_noise import has_same_noise
from .stand_ins import held_otherwise
from .summary import add
from .unmoved import Flatness, Stops, is_unmoved

if TYPE_CHECKING:
    from .conventions import Verdict
    from .lens import Drift
    from .motion_statistics import MotionStatistics

HAS_TORCH = find_spec("torch") is not None
PAIRS, LEAST_PAIRS = 6, 2  # of consecutive frames whose pixels are examined; of large ones no more than needed
PIXELS = 25_000_000  # of all these frames, which are in memory at once: some 3 GB


@dataclass(frozen=True)
class FoundLayer:
    """A layer of `Frame` and its source in the files."""

    name: str
    channels: tuple[str, ...]  # `layout.Rule.formulas`
    dtype: str  # "half", "float", "uint", or several
    used: bool  # whether a denoiser reads it; other layers serve evaluation or the computation of motion


@dataclass(frozen=True)
class Inspection:
    """The findings of `inspect`."""

    source: str
    files: int
    numbers: tuple[int, int]  # first and last
    gaps: tuple[tuple[int, int], ...]  # (first, last) missing number of each
    size: tuple[int, int]  # (H, W)
    preset: str
    signal: str
    demodulated: bool  # whether the renderer has already divided the signal by the albedo
    layers: tuple[FoundLayer, ...]
    missing: dict[str, str]  # missing layer that a denoiser would use -> how to get it
    guessed: tuple[str, ...]  # of these, such as the files seem to hold by other names
    beside: tuple[str, ...]  # and such as files beside seem to hold, where the source is a glob
    computed: tuple[str, ...]  # layers that are computed from position, id and scene.json
    ignored: tuple[str, ...]  # channels that nothing reads
    dual_motion: str  # the source of dual motion, in words
    scene: bool  # whether there is a scene.json
    examined: tuple[int, ...]  # numbers of the frames whose pixels were read
    pairs: int  # of consecutive frames that were compared
    flat_albedo: bool  # whether albedo is the same in all pixels of the examined frames
    normals: str  # what is wrong with them
    faults: dict[str, int]  # "layer: fault" -> pixels of the examined frames that denoising will replace
    motion: MotionStatistics | None
    same_noise: tuple[int, ...]  # numbers of frames with the noise of the frame before
    unmoved: tuple[int, ...]  # numbers of frames whose motion is zero everywhere though the picture changes
    stopped: bool  # whether motion_next is zero everywhere though motion is not
    convention: Verdict | None  # None where there is no motion, or no two consecutive frames
    drifts: tuple[Drift, ...]  # zooms and shifts that the vectors lack, of the pairs of frames that have any
    plan: Plan  # the work that `denoise` will leave out


def inspect(
    source: str | os.PathLike,
    *,
    signal: str = "color",
    preset: str = "auto",
    allow_gaps: bool = False,
) -> Inspection:
    """Examine a sequence. All headers are read, and the pixels of a few frames; of a render region those within.

    Raises `InputError` as `open_sequence` does.
    """
    sequence = open_sequence(source, signal=signal, preset=preset, layers=("reference",), allow_gaps=allow_gaps)
    sequence = with_region(sequence)
    chosen = choose_pairs(sequence.numbers, sequence.size)
    frames = {i: sequence.read(i) for i in sorted({i for pair in chosen for i in pair} or {0})}
    plan = make_plan(sequence.size, len(sequence), "dual", list(frames.values()))
    if region := sequence.beyond:
        frames = {i: frame.map(region.cropped) for i, frame in frames.items()}
    moving = [(frames[a], frames[b]) for a, b in chosen if frames[b].motion is not None]
    counts, flatness, stops = dict[str, int](), Flatness(), Stops()
    for frame in frames.values():
        flatness.see(frame)
        stops.see(frame)
        add(counts, faults(frame))

    motion, convention, drifts = _examine(moving) if moving and HAS_TORCH else (None, None, ())
    right = convention and convention.status != "wrong"
    present = {layer for frame in frames.values() for layer, _ in frame.layers()}
    computed = tuple(sorted(present - sequence.available.keys()))
    absent = [layer for layer in DEFAULT_LAYERS if layer not in sequence.available and layer not in computed]
    read = [*sequence.available.values(), *_read_besides(sequence)]
    fed = {*(name for rule in read for name in rule.channels), sequence.layout.alpha(sequence.header)}
    called, beside = held_otherwise(sequence, source) if preset == "auto" else ((), ())
    return Inspection(
        source=str(source),
        files=len(sequence),
        numbers=(sequence.numbers[0], sequence.numbers[-1]),
        gaps=sequence.gaps,
        size=sequence.size,
        preset=sequence.layout.name,
        signal=signal,
        demodulated=sequence.demodulated,
        layers=_layers(sequence),
        missing={layer: sequence.layout.hint(layer, signal) for layer in absent},
        guessed=tuple(layer for layer in absent if layer in called),
        beside=tuple(layer for layer in absent if layer in beside and layer not in called),
        computed=computed,
        ignored=tuple(name for name in sequence.header.channels if name not in fed),
        dual_motion=_dual_source(present, computed),
        scene=sequence.scene is not None,
        examined=tuple(frame.number for frame in frames.values()),
        pairs=len(chosen),
        flat_albedo=flatness.found,
        normals=told_of_normals(frames.values(), moving if right else ()),
        faults=counts,
        motion=motion,
        same_noise=() if drifts else tuple(frames[b].number for a, b in chosen if has_same_noise(frames[a], frames[b])),
        unmoved=() if drifts else tuple(now.number for before, now in moving if is_unmoved(before, now)),
        stopped=stops.found and not drifts,
        convention=convention,
        drifts=drifts,
        plan=plan,
    )


def _examine(pairs: list[tuple[Frame, Frame]]) -> tuple[MotionStatistics, Verdict, tuple[Drift, ...]]:
    """The motion in pairs of consecutive frames of numpy arrays. Needs torch."""
    import torch

    from .conventions import check_motion
    from .lens import find_drift
    from .motion_statistics import motion_statistics

    tensors = [(before.map(torch.from_numpy), now.map(torch.from_numpy)) for before, now in pairs]
    verdict = check_motion(tensors)
    drifts = () if verdict.status == "wrong" else filter(None, (find_drift(*pair) for pair in tensors))
    return motion_statistics(tensors), verdict, tuple(drifts)


def choose_pairs(numbers: tuple[int, ...], size: tuple[int, int]) -> list[tuple[int, int]]:
    """Indices of `PAIRS` pairs of consecutive frames at most, evenly spread over the sequence: of frames of this size
    (H, W) that `PIXELS` allows, but `LEAST_PAIRS` of any."""
    consecutive = [(i - 1, i) for i in range(1, len(numbers)) if numbers[i] == numbers[i - 1] + 1]
    most = min(PAIRS, max(LEAST_PAIRS, PIXELS // (2 * size[0] * size[1])))
    if len(consecutive) <= most:
        return consecutive
    return [consecutive[round(k * (len(consecutive) - 1) / (most - 1))] for k in range(most)]


def _read_besides(sequence: Sequence) -> list[Rule]:
    """What `denoise` reads to mend others by: the light of volumes and of the sky, and the length of paths."""
    beauty = sequence.signal == "color"  # `choice.open_chosen`
    path, fog = replace(sequence, fog=beauty, virtual_motion=beauty).besides(sequence.files[0])
    return [*fog.values(), *([path] if path else [])]


def _layers(sequence: Sequence) -> tuple[FoundLayer, ...]:
    types = sequence.header.channels
    return tuple(
        FoundLayer(
            name=name,
            channels=rule.formulas,
            dtype=", ".join(dict.fromkeys(types[c] for c in rule.channels)),
            used=name in DEFAULT_LAYERS,
        )
        for name, rule in sequence.available.items()
    )


def _dual_source(present: set[str], computed: tuple[str, ...]) -> str:
    if "motion" not in present:
        return "none: there is no motion"
    if "motion_next" in present:
        return "exact, from motion_next" + (" (computed)" if "motion_next" in computed else "")
    if "depth" in present:
        return "approximate: motion_next is missing and is splatted from motion and depth (docs/use/motion.md)"
    return "none: without motion_next and depth, history follows traditional motion"
