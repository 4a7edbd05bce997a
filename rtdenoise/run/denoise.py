"""Denoise a sequence of EXR files into a folder: `rtdenoise denoise SEQ --out DIR`. Interrupted runs go on where they
stopped, and finished runs where frames were appended."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..data.output import check_output, output_names, write_frame
from ..data.sequences import Sequence, open_sequence
from ..data.stored import read_history, write_history
from ..errors import InputError
from ..files import lock, remove_unfinished
from ..frame import MAX_CUT_MISMATCH
from ..sanitise import faults
from .backends import Backend, open_backend
from .folder import Written, are_finished, digest, prepare, refuse_foreign, refuse_other, write_summary

if TYPE_CHECKING:
    from .plan import Plan

STATE = ".rtdenoise-state.safetensors"  # in the output folder: the history after the last finished frame
SUMMARY = "denoise.json"
EXAMINED = 3  # frames that the plan examines


@dataclass(frozen=True)
class Options:
    """The options of a run."""

    signal: str = "color"
    """The signal to denoise: 'color' (the beauty) or 'indirect'."""
    model: str = "default"
    """The network: 'default', 'fast', 'quality', 'paper', or a .safetensors file that `rtdenoise train` wrote."""
    preset: str = "auto"
    """Layout of the input: 'auto', 'native', 'cycles', 'mitsuba', 'falcor', 'bmfr', 'oidn', 'noisebase', or a .toml
    file."""
    layout: str = "plain"
    """Channels of the output files: 'plain' (the result in R,G,B) or 'source' (a copy of the input with the result in
    its place)."""
    recombine: bool = False
    """Add the rest of the light to the denoised signal: the result is the beauty."""
    keep: tuple[str, ...] = ()
    """Layers of the input to copy into the output ('albedo', 'depth' ...), or 'all'."""
    float32: bool = False
    """Write 32-bit float instead of 16-bit half."""
    allow_gaps: bool = False
    """Accept missing frame numbers; history starts anew after each gap."""
    detect_cuts: bool = True
    """Start history anew where most pixels find another surface than their motion vectors promise."""
    plan: bool = True
    """Leave out work that a frame does not need (`rtdenoise inspect` lists it); off: everything runs."""
    backend: str = "auto"
    """'torch', 'glsl' (OpenGL compute shaders, needs no PyTorch), or 'auto': torch where it is installed."""
    device: str = "auto"
    """Device of the torch backend: 'auto', 'cpu' or 'cuda'."""
    offline: bool = False
    """The best picture for frames on disk: uses the frames after as well as those before, and OIDN where it is
    installed. Takes several times as long."""
    confidence: bool = False
    """With --offline: also write how far the candidates lie apart, in radiance, as the layer 'confidence' (small is
    sure)."""
    precision: str = "auto"
    """Precision of the network: 'fp32', 'bf16' (torch), 'fp16' (glsl, for stored activations), or 'auto' (torch: bf16
    where the hardware is faster with it; glsl: fp32)."""


@dataclass
class Summary:
    """The outcome of a run. All but `written`, `skipped` and `seconds` include earlier, interrupted runs."""

    written: int = 0
    skipped: int = 0
    seconds: float = 0.0  # in the denoiser alone
    replaced: dict[str, int] = field(default_factory=dict)  # "layer: what was wrong" -> pixels (`sanitise.faults`)
    passed_on: dict[str, int] = field(default_factory=dict)  # channel copied from the input -> NaNs in it
    cuts: list[int] = field(default_factory=list)  # numbers of the frames that start a shot
    gaps: list[tuple[int, int]] = field(default_factory=list)  # (first, last) missing frame number of each gap
    left_out: dict[str, int] = field(default_factory=dict)  # what -> frames that did without it
    notes: list[str] = field(default_factory=list)  # what else the user should know
    plan: Plan | None = None


def denoise(
    source: str,
    out: str | Path,
    options: Options = Options(),
    overwrite: bool = False,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Summary:
    """Denoise every frame of `source` (folder or glob) into `out`, one file of the same name each; see `data.output`
    for what is in it.

    Frames that an earlier run with the same options has finished are skipped, and history goes on from its saved
    state, so the outcome is that of one undisturbed run: also where it was interrupted, and where frames have been
    appended to the input since. `on_frame(done, total)` is called at the start and after each frame.

    With `options.offline` see `offline.denoise_offline`: there `total` counts the frames of both passes.

    Raises InputError for anything wrong with the input, the options or the output folder.
    """
    if options.offline:
        from .offline import denoise_offline

        return denoise_offline(source, out, options, overwrite, on_frame)
    if options.confidence:
        raise InputError("--confidence: goes with --offline")
    sequence = open_sequence(source, signal=options.signal, preset=options.preset, allow_gaps=options.allow_gaps)
    sequence.require("albedo", "normal", "depth", *(("motion",) if len(sequence) > 1 else ()))
    check_output(sequence, options.layout, options.recombine, options.keep)
    backend = open_backend(options.backend, options.model, options.device, options.precision)
    out = prepare(Path(out), sequence, options)
    with lock(out):
        remove_unfinished(out)
        return _run(sequence, out, options, backend, overwrite, on_frame)


def _run(
    sequence: Sequence,
    out: Path,
    options: Options,
    backend: Backend,
    overwrite: bool,
    on_frame: Callable[[int, int], None],
) -> Summary:
    fingerprints = digest(sequence, options)
    done, history, summary = (
        (0, None, Summary()) if overwrite else _resume(out, sequence, fingerprints, backend, options)
    )
    if not done:  # so that the next run knows the first frame for its own
        save_state(out / STATE, {}, 0, fingerprints[0], summary, options)
    summary.skipped, summary.gaps = done, list(sequence.gaps)
    names = output_names(sequence, options.layout, options.recombine)
    written = Written(out, names[:done])
    if options.plan:
        first = [sequence.read(i) for i in range(min(EXAMINED, len(sequence)))]
        summary.plan = backend.plan(sequence.size, len(sequence), first, summary.left_out)
    if summary.plan:
        sequence = sequence.only(summary.plan.layers)

    on_frame(done, len(sequence))
    for i in range(done, len(sequence)):
        frame = sequence.read(i)
        for what, count in faults(frame).items():
            summary.replaced[what] = summary.replaced.get(what, 0) + count
        if i and frame.number != sequence.numbers[i - 1] + 1:
            history = None
        started = time.perf_counter()
        prepared = backend.prepare(frame)
        if options.detect_cuts and history is not None and backend.mismatch(prepared, history) > MAX_CUT_MISMATCH:
            summary.cuts.append(frame.number)
            history = None
        image, history = backend.step(prepared, history)
        summary.seconds += time.perf_counter() - started
        nans = write_frame(out, sequence, i, frame, image, layout=options.layout, recombine=options.recombine,
                           keep=options.keep, float32=options.float32)  # fmt: skip
        for channel, count in nans.items():
            summary.passed_on[channel] = summary.passed_on.get(channel, 0) + count
        written.add(names[i])
        save_state(out / STATE, backend.save(history), i + 1, fingerprints[i + 1], summary, options, written.digest)
        summary.written += 1
        on_frame(i + 1, len(sequence))
    write_summary(out / SUMMARY, sequence, options, summary)
    return summary


def _resume(
    out: Path, sequence: Sequence, fingerprints: list[str], backend: Backend, options: Options
) -> tuple[int, Any, Summary]:
    """How many frames are finished, the history after them, and what there was to say about them."""
    names = output_names(sequence, options.layout, options.recombine)
    if not (out / STATE).exists():
        refuse_foreign(out, names)
        return 0, None, Summary()
    done, history, summary, metadata = read_state(out / STATE, backend)
    if done <= 0:  # whatever is there is of a run that did not come as far as its second frame
        return 0, None, Summary()
    refuse_other(out, metadata, options, fingerprints[done] if done <= len(sequence) else "")
    if not are_finished(out, names[:done], sequence.size, metadata.get("written", "")):
        return 0, None, Summary()
    return done, history, summary


def read_state(path: Path, backend: Backend | None = None) -> tuple[int, Any, Summary, dict]:
    """What `save_state` wrote: frames done, the history (None without a backend to restore it), the summary so far, and
    the rest. Raises InputError where the file is damaged."""
    try:
        stored, metadata = read_history(path)
        done, summary = int(metadata["done"]), _counts(json.loads(metadata["so_far"]))
        options = dict(json.loads(metadata.get("options", "{}")))
        history = backend.restore(stored) if stored and backend else None
    except (InputError, KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: not readable ({error}); pass --overwrite to start anew") from None
    return done, history, summary, {**metadata, "options": options}


def _counts(so_far: dict) -> Summary:
    """The summary of an earlier run, from its saved state. Raises ValueError and others where it is not one's."""
    summary = Summary(**{key: so_far[key] for key in ("replaced", "cuts", "left_out")})
    summary.passed_on = dict(so_far.get("passed_on", {}))  # older states lack it
    counts = (summary.replaced, summary.left_out, summary.passed_on)
    if not all(type(n) is int for n in (*summary.cuts, *(n for count in counts for n in count.values()))):
        raise ValueError("counts that are no integers")
    return summary


def save_state(
    path: Path, history: dict, done: int, fingerprint: str, summary: Summary, options: Options, written: str = ""
) -> None:
    """Write the state of a run: `history` is a backend's `save`, `written` a `folder.Written.digest`."""
    so_far = {key: getattr(summary, key) for key in ("replaced", "passed_on", "cuts", "left_out")}
    metadata = {"done": str(done), "fingerprint": fingerprint, "so_far": json.dumps(so_far), "written": written}
    write_history(path, history, metadata | {"options": json.dumps(asdict(options))})
