"""Denoise a sequence of EXR files into a folder: `rtdenoise denoise SEQ --out DIR`. Interrupted runs go on where they
stopped, and finished runs where frames were appended."""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..data.exr import read_header
from ..data.output import check_output, output_names, protect_input, write_frame
from ..data.sequences import Sequence, open_sequence
from ..data.stored import read_history, write_history
from ..errors import InputError
from ..files import dumps, lock, remove_unfinished, write_atomically
from ..frame import MAX_CUT_MISMATCH
from ..models.weights import find
from ..sanitise import faults
from .backends import Backend, open_backend

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
    precision: str = "auto"
    """Precision of the network: 'fp32', 'bf16' (torch), 'fp16' (glsl, for stored activations), or 'auto' (torch: bf16
    where the hardware is faster with it; glsl: fp32)."""


# Options that change the files.
DECISIVE = tuple(f.name for f in fields(Options) if f.name not in ("backend", "device"))


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

    Raises InputError for anything wrong with the input, the options or the output folder.
    """
    sequence = open_sequence(source, signal=options.signal, preset=options.preset, allow_gaps=options.allow_gaps)
    sequence.require("albedo", "normal", "depth", *(("motion",) if len(sequence) > 1 else ()))
    check_output(sequence, options.layout, options.recombine, options.keep)
    backend = open_backend(options.backend, options.model, options.device, options.precision)
    out = _prepare(Path(out), sequence, options)
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
    fingerprints = _fingerprints(sequence, options)
    done, history, summary = (
        (0, None, Summary()) if overwrite else _resume(out, sequence, fingerprints, backend, options)
    )
    if not done:  # so that the next run knows the first frame for its own
        _save_state(out / STATE, {}, 0, fingerprints[0], summary, options)
    summary.skipped, summary.gaps = done, list(sequence.gaps)
    names = output_names(sequence, options.layout, options.recombine)
    written = _Written(out, names[:done])
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
        _save_state(out / STATE, backend.save(history), i + 1, fingerprints[i + 1], summary, options, written.digest)
        summary.written += 1
        on_frame(i + 1, len(sequence))
    _write_summary(out / SUMMARY, sequence, options, summary)
    return summary


def _write_summary(path: Path, sequence: Sequence, options: Options, summary: Summary) -> None:
    plan = summary.plan and summary.plan.to_json()
    document = {
        "frames": len(sequence), "first": sequence.numbers[0], "last": sequence.numbers[-1], "size": sequence.size,
        "options": asdict(options), **asdict(summary), "plan": plan,
    }  # fmt: skip
    write_atomically(path, (dumps(document, indent=1) + "\n").encode())


def _prepare(out: Path, sequence: Sequence, options: Options) -> Path:
    """The output folder, made if need be; never one that holds the input."""
    protect_input(sequence, out, options.layout, options.recombine)
    try:
        out.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=out).close()
    except OSError as error:
        raise InputError(f"{out}: cannot write there: {error.strerror}") from None
    return out


def _fingerprints(sequence: Sequence, options: Options) -> list[str]:
    """Tells runs apart that would write different files: entry k is for the first k frames, whatever comes after."""
    parts = {name: getattr(options, name) for name in DECISIVE}
    parts["layers"] = [repr(sequence.rules), repr(sequence.layout)]  # a layout of one's own may have been mended
    parts["weights"] = hashlib.sha256(find(options.model).read_bytes()).hexdigest()
    scene = sequence.scene or {}
    parts["scene"] = {key: value for key, value in scene.items() if key != "frames"}
    cameras = {entry["number"]: entry for entry in scene.get("frames", ())}
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True, default=list).encode())
    fingerprints = [digest.hexdigest()]
    for frame in sequence.files:
        inputs = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in frame.files.values()]
        seen = [cameras.get(frame.number + step) for step in (-1, 0, 1)]  # what its motion is computed from
        digest.update(json.dumps([inputs, seen], sort_keys=True).encode())
        fingerprints.append(digest.hexdigest())
    return fingerprints


def _resume(
    out: Path, sequence: Sequence, fingerprints: list[str], backend: Backend, options: Options
) -> tuple[int, Any, Summary]:
    """How many frames are finished, the history after them, and what there was to say about them."""
    names = output_names(sequence, options.layout, options.recombine)
    if not (out / STATE).exists():
        clash = [name for name in chain(*names) if (out / name).exists()]
        if clash:
            raise InputError(
                f"{out / clash[0]}: exists and is not from an earlier run; choose another --out or pass --overwrite"
            )
        return 0, None, Summary()
    try:
        stored, metadata = read_history(out / STATE)
        done, summary = int(metadata["done"]), _counts(json.loads(metadata["so_far"]))
        before = dict(json.loads(metadata.get("options", "{}")))
        history = backend.restore(stored) if stored else None
    except (InputError, KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{out / STATE}: not readable ({error}); pass --overwrite to start anew") from None
    if done <= 0:  # whatever is there is of a run that did not come as far as its second frame
        return 0, None, Summary()
    if done > len(sequence) or metadata.get("fingerprint") != fingerprints[done]:
        other = _changed(before, options)
        raise InputError(f"{out}: holds frames of a run with {other}; choose another --out or pass --overwrite")
    finished = list(chain(*names[:done]))
    if any(not (out / name).exists() for name in finished):
        return 0, None, Summary()
    for name in finished:
        _refuse_junk(out / name, sequence.size)
    if metadata.get("written", "") not in ("", _Written(out, names[:done]).digest):  # older states do not record it
        raise InputError(f"{out}: a finished frame has another size in bytes than it was written with; pass "
                         "--overwrite to denoise all of them again")  # fmt: skip
    return done, history, summary


class _Written:
    """The finished files, as one digest of their names and sizes in bytes."""

    def __init__(self, out: Path, frames: Iterable[list[str]]) -> None:
        self._out, self._hash = out, hashlib.sha256()
        for names in frames:
            self.add(names)

    def add(self, names: list[str]) -> None:
        for name in names:
            self._hash.update(f"{name}\0{(self._out / name).stat().st_size}\n".encode("utf-8", "surrogateescape"))

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()


def _refuse_junk(path: Path, size: tuple[int, int]) -> None:
    """Raise InputError where a finished frame is no complete EXR file of this size (height, width) any more."""
    try:
        header = read_header(path)
        problem = None if (header.height, header.width) == size else f"{header.width}×{header.height} pixels"
    except InputError as error:
        problem = str(error).removeprefix(f"{path}: ")
    if problem:
        raise InputError(f"{path}: this frame was finished, and has been damaged or replaced since ({problem}); remove "
                         "it, or pass --overwrite")  # fmt: skip


def _counts(so_far: dict) -> Summary:
    """The summary of an earlier run, from its saved state. Raises ValueError and others where it is not one's."""
    summary = Summary(**{key: so_far[key] for key in ("replaced", "cuts", "left_out")})
    summary.passed_on = dict(so_far.get("passed_on", {}))  # older states lack it
    counts = (summary.replaced, summary.left_out, summary.passed_on)
    if not all(type(n) is int for n in (*summary.cuts, *(n for count in counts for n in count.values()))):
        raise ValueError("counts that are no integers")
    return summary


def _changed(before: dict, options: Options) -> str:
    """The options that differ, in words; states of older runs do not record them."""
    now = json.loads(json.dumps(asdict(options)))  # tuples become lists, as in `before`
    changed = [key for key in DECISIVE if key in before and before[key] != now[key]]
    told = ", ".join(f"{key.replace('_', '-')} {before[key]}, now {now[key]}" for key in changed)
    return f"other options: {told}" if told else "other options or input"


def _save_state(
    path: Path, history: dict, done: int, fingerprint: str, summary: Summary, options: Options, written: str = ""
) -> None:
    so_far = {key: getattr(summary, key) for key in ("replaced", "passed_on", "cuts", "left_out")}
    metadata = {"done": str(done), "fingerprint": fingerprint, "so_far": json.dumps(so_far), "written": written}
    write_history(path, history, metadata | {"options": json.dumps(asdict(options))})
