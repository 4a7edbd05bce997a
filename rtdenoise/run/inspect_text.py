"""The findings of `inspect` in words: the text for a terminal, and the next thing to do."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from types import MappingProxyType

from rich.console import Console
from rich.table import Table

from ..data.exr_format import group_channels
from ..data.files import describe_gap
from ..data.layouts import MITSUBA, NATIVE
from ..data.numbering import told_of_order
from ..errors import INSTALL_TORCH
from ..wording import counted
from .inspect import HAS_TORCH, Inspection
from .normals import ENCODED
from .same_noise import SAME_NOISE
from .stand_ins import COSTS, STAND_INS
from .unmoved import FLAT, STOPPED, UNMOVED

MAX_SHOWN = 24  # values in a line
MOSTLY = 0.75  # share of the pairs of frames from which on noise stands still: on twos every frame is shown twice


def next_step(found: Inspection, options: Mapping[str, str | bool] = MappingProxyType({})) -> str:
    """The next thing to do: a layer to add, motion to mend, or the command that denoises the sequence. `options` are
    those of `inspect` that were not the defaults."""
    given = [w for n, v in options.items() if n != "preset" for w in _words(n, v)]
    describe = shlex.join(["rtdenoise", "inspect", found.source, *given, "--write", "my.toml"])
    if found.convention and found.convention.status == "wrong":
        advice = f", or describe them: {describe}" if found.preset in (NATIVE.name, "cycles") else ""
        order = "the order of the frames or " if told_of_order(found.numbers) else ""
        return f"mend {order}the motion vectors as said above{advice}: with these, history comes from wrong places"
    if found.guessed:
        return f"{describe}, which describes {', '.join(found.guessed)}: the files seem to call them otherwise"
    if found.stopped and found.preset in (NATIVE.name, MITSUBA.name):
        return f"{describe}, which leaves out motion_next"
    if found.normals == ENCODED and found.preset in (NATIVE.name, MITSUBA.name):
        return f"{describe}, which describes normals as they are stored"
    if found.beside:
        return f"{describe}, which describes {', '.join(found.beside)}: files beside seem to hold them"
    if found.same_noise and len(found.same_noise) >= MOSTLY * found.pairs:
        return "render again, with another seed in every frame: noise that stands still is not averaged"
    if 2 * len(found.unmoved) > found.pairs:  # not the cuts between still shots
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
    console = Console(width=120, markup=False, emoji=False, highlight=False, no_color=True)
    with console.capture() as capture:
        console.print(found.source, style="bold", soft_wrap=True)
        for label, text in _summary(found, verbose):
            console.print(f"  {label:<12} {text}", soft_wrap=True)
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
        ("frames", f"{counted(found.files, 'file')}, {W}×{H}, numbers {first} to {last}{gaps}"),
        *(("", line) for line in told_of_order(found.numbers)),
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
