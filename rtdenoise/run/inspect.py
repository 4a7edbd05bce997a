"""Inspect a sequence before denoising: its layers, their use, and the convention of its motion vectors."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from types import MappingProxyType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from ..data.exr_format import group_channels
from ..data.files import describe_gap
from ..data.layout import Rule
from ..data.layouts import MITSUBA, NATIVE
from ..data.sequences import DEFAULT_LAYERS, Sequence, open_sequence
from ..errors import INSTALL_TORCH
from ..frame import Frame
from ..sanitise import faults
from .normals import ENCODED, told_of_normals
from .options import add
from .plan import Plan, make_plan
from .same_noise import SAME_NOISE, has_same_noise
from .stand_ins import COSTS, STAND_INS, held_otherwise
from .unmoved import FLAT, STOPPED, UNMOVED, Flatness, Stops, is_unmoved

if TYPE_CHECKING:
    from .conventions import Verdict
    from .lens import Drift
    from .motion_statistics import MotionStatistics

HAS_TORCH = find_spec("torch") is not None
PAIRS = 6  # of consecutive frames whose pixels are examined
MAX_SHOWN = 24  # values in a line


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
    """Examine a sequence. All headers are read, and the pixels of a few frames.

    Raises `InputError` as `open_sequence` does.
    """
    sequence = open_sequence(source, signal=signal, preset=preset, layers=("reference",), allow_gaps=allow_gaps)
    chosen = choose_pairs(sequence.numbers)
    frames = {i: sequence.read(i) for i in sorted({i for pair in chosen for i in pair} or {0})}
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
        flat_albedo=flatness.found,
        normals=told_of_normals(frames.values(), moving if right else ()),
        faults=counts,
        motion=motion,
        same_noise=() if drifts else tuple(frames[b].number for a, b in chosen if has_same_noise(frames[a], frames[b])),
        unmoved=() if drifts else tuple(now.number for before, now in moving if is_unmoved(before, now)),
        stopped=stops.found and not drifts,
        convention=convention,
        drifts=drifts,
        plan=make_plan(sequence.size, len(sequence), "dual", list(frames.values())),
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


def choose_pairs(numbers: tuple[int, ...]) -> list[tuple[int, int]]:
    """Indices of `PAIRS` pairs of consecutive frames at most, evenly spread over the sequence."""
    consecutive = [(i - 1, i) for i in range(1, len(numbers)) if numbers[i] == numbers[i - 1] + 1]
    if len(consecutive) <= PAIRS:
        return consecutive
    return [consecutive[round(k * (len(consecutive) - 1) / (PAIRS - 1))] for k in range(PAIRS)]


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


def next_step(found: Inspection, options: Mapping[str, str | bool] = MappingProxyType({})) -> str:
    """The next thing to do: a layer to add, motion to mend, or the command that denoises the sequence. `options` are
    those of `inspect` that were not the defaults."""
    given = [w for n, v in options.items() if n != "preset" for w in _words(n, v)]
    describe = shlex.join(["rtdenoise", "inspect", found.source, *given, "--write", "my.toml"])
    if found.convention and found.convention.status == "wrong":
        advice = f", or describe them: {describe}" if found.preset == NATIVE.name else ""
        return f"mend the motion vectors as said above{advice}: with these, history comes from wrong places"
    if found.guessed:
        return f"{describe}, which describes {', '.join(found.guessed)}: the files seem to call them otherwise"
    if found.stopped and found.preset in (NATIVE.name, MITSUBA.name):
        return f"{describe}, which leaves out motion_next"
    if found.normals == ENCODED and found.preset in (NATIVE.name, MITSUBA.name):
        return f"{describe}, which describes normals as they are stored"
    if found.beside:
        return f"{describe}, which describes {', '.join(found.beside)}: files beside seem to hold them"
    if 2 * len(found.same_noise) >= len(found.examined):
        return "render again, with another seed in every frame: noise that stands still is not averaged"
    if 2 * len(found.unmoved) >= len(found.examined):  # not the cuts between still shots
        return ("render again without motion blur, and name that by --surfaces for a picture with blur, or mend the "
                "motion: with zeros, what moves leaves trails")  # fmt: skip
    words = ["rtdenoise", "denoise", found.source, "--out", "clean/"]
    for name, value in options.items():
        words += _words(name, value)
    command = shlex.join([*words, *(["--lens"] if found.drifts else [])])
    wanted = (*STAND_INS, *(("motion",) if found.files > 1 else ()))
    if absent := [layer for layer in wanted if layer in found.missing]:
        return f"add {absent[0]}: {found.missing[absent[0]]} (without it {COSTS[absent[0]]}); then {command}"
    if found.convention and found.convention.status == "ambiguous" and found.convention.errors and not found.drifts:
        return f"look at the motion vectors first, nothing confirms them; then {command}"
    return command


def _words(option: str, value: str | bool) -> list[str]:
    """An option as it is typed."""
    return [f"--{option.replace('_', '-')}", *([] if value is True else [str(value)])]


def render_text(found: Inspection, verbose: bool = False) -> str:
    """The inspection as text for a terminal 120 characters wide; `verbose` also lists the work that nothing spares."""
    console = Console(width=120, highlight=False, no_color=True)
    with console.capture() as capture:
        console.print(f"[bold]{found.source}[/bold]", soft_wrap=True)
        for label, text in _summary(found, verbose):
            console.print(f"  {label:<12} {text}", markup=False, soft_wrap=True)
        table = Table(box=None, padding=(0, 2, 0, 0), title="layers", title_justify="left")
        for column in ("layer", "stored as", "from channels", "used for"):
            table.add_column(column)
        for layer in found.layers:
            purpose = "denoising" if layer.used else "evaluation" if "reference" in layer.name else "motion, if missing"
            table.add_row(layer.name, layer.dtype, ", ".join(layer.channels), purpose)
        for name, hint in found.missing.items():
            table.add_row(name, "missing", "", hint)
        console.print(table)
    return capture.get().rstrip("\n")


def _summary(found: Inspection, verbose: bool) -> list[tuple[str, str]]:
    """(label, text) pairs, a line each."""
    (H, W), (first, last) = found.size, found.numbers
    missing = sum(end - start + 1 for start, end in found.gaps)
    numbers = _shorten(tuple(map(describe_gap, found.gaps)))
    gaps = f"; {missing} missing: {numbers}" if missing else ", none missing"
    scene = "yes" if found.scene else "no"
    bad = ", ".join(f"{what} ({count})" for what, count in found.faults.items()) or "none"
    divided = ", already divided by the albedo" if found.demodulated else ""
    lines = [
        ("frames", f"{found.files} files, {W}×{H}, numbers {first} to {last}{gaps}"),
        ("layout", f"{found.preset}; signal {found.signal}{divided}; scene.json: {scene}"),
        ("not used", group_channels(found.ignored) or "-"),
        ("examined", f"frames {_shorten(found.examined)}"),
        ("bad pixels", bad),
    ]
    if found.same_noise:
        lines.append(("noise", SAME_NOISE.format(f"frames {_shorten(found.same_noise)}").removeprefix("the noise ")))
    if found.flat_albedo:
        lines.append(("albedo", FLAT.format("the frames examined").removeprefix("albedo ")))
    if found.normals:
        lines.append(("normals", found.normals))
    lines.append(("dual motion", found.dual_motion))
    if found.computed:
        lines.append(("computed", f"{', '.join(found.computed)} (from positions and the cameras beside the frames)"))
    if m := found.motion:
        uncovered = "unknown without motion_next and depth" if m.uncovered is None else f"{m.uncovered:.2%}"
        lines += [
            ("motion", f"mean {m.mean:.2f} px, median {m.p50:.2f}, 99 % below {m.p99:.2f}, largest {m.max:.2f}"),
            ("", f"zero in {m.still:.1%} of the pixels, from off screen {m.off_screen:.2%}, uncovered {uncovered}"
                 + (f", unknown in {m.unknown:.1%}" if m.unknown else "")),
        ]
    if found.unmoved:
        lines.append(("", UNMOVED.format(f"frames {_shorten(found.unmoved)}")))
    if found.stopped:
        lines.append(("", STOPPED))
    if found.convention is None:
        needs = "motion in two consecutive frames" if HAS_TORCH else f"PyTorch; {INSTALL_TORCH}"
        lines.append(("convention", f"not checked: it takes {needs}"))
    else:
        compared = f" (compared: {found.convention.feature})" if found.convention.feature else ""
        lines.append(("convention", f"{found.convention.status.upper()}: {found.convention.message}{compared}"))
    if found.drifts:
        lines.append(("lens", f"{found.drifts[0]} (in {len(found.drifts)} of the pairs of frames examined)"))
    decisions = [d for d in found.plan.decisions if verbose or not d.left_out.startswith(("0 of", "never"))]
    for i, decision in enumerate(decisions):
        lines.append(("" if i else "left out", f"{decision.what}: {decision.left_out} ({decision.why})"))
    return lines


def _shorten(values: tuple) -> str:
    """Comma-separated values, at most `MAX_SHOWN` of them."""
    shown = ", ".join(map(str, values[:MAX_SHOWN]))
    return shown + (f", … ({len(values)} in all)" if len(values) > MAX_SHOWN else "")
