"""`rtdenoise evaluate SEQ... --out DIR`: methods × precisions × samples per pixel, error and time in one run.

DIR/evaluation.json holds all numbers (`document.Document`), DIR/pictures/SEQ/FRAME/METHOD.exr the frames to look at.
What is in the file already is not run again, unless its input or its weights have changed.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from .. import models
from ..color import display_exposure
from ..data.exr import write_layers
from ..errors import InputError
from ..frame import Frame
from ..origin import LIBRARIES, device_name, origin, typed
from .document import NAME, Document
from .inputs import Source, reference_error
from .measure import ALL_METRICS, ALL_REGIONS, Result, evaluate, uncovered, warm_up
from .registry import PRECISIONS, Method, Step, choose

MEASURED_WITH = (*LIBRARIES, "pyoidn", "scikit-image", "flip-evaluator")


@dataclass(frozen=True)
class Options:
    """What `run` measures."""

    methods: tuple[str, ...] = ()  # () : all
    precisions: tuple[str, ...] = ("fp32",)  # of PRECISIONS
    spp: tuple[int, ...] = (1,)
    signal: str = "color"
    preset: str = "auto"
    frames: int | None = None  # at most so many of each sequence
    device: str = "cpu"


def run(sources: list[str], out: Path, options: Options, say: Callable[[str], None] = print) -> Document:
    """Measure, and write after every input. Raises InputError for unknown methods and for sequences that cannot be
    measured; an input, a method or a precision that is missing is skipped with its reason."""
    if unknown := [name for name in options.precisions if name not in PRECISIONS]:
        raise InputError(f"unknown precision {unknown[0]!r}; expected some of {', '.join(PRECISIONS)}")
    chosen = choose(options.methods)
    opened = [Source.open(folder, options.signal, options.preset, options.frames) for folder in sources]
    names = [source.name for source in opened]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two sequences are called {twice[0]!r}: results go by the folder's name; rename one")
    document = _open_document(out, options.signal)
    document.runs.append(origin(typed(), {options.device: device_name(options.device)}, MEASURED_WITH))
    document.methods |= {method.name: {"what": method.what, "family": method.family} for method in chosen}
    for source in opened:
        for spp in options.spp:
            _measure(document, out, source, spp, chosen, options, say)
            document.write(out)
    return document


def _open_document(out: Path, signal: str) -> Document:
    out.mkdir(parents=True, exist_ok=True)
    if not (out / NAME).exists():
        return Document(signal)
    document = Document.read(out)
    if document.signal != signal:
        raise InputError(f"{out}: holds results of the signal '{document.signal}'; choose another --out")
    return document


def _measure(
    document: Document, out: Path, source: Source, spp: int, chosen: list[Method], options: Options, say: Callable
) -> None:
    """All methods on one input, in turn."""
    key = {"sequence": source.name, "spp": spp, "device": options.device}
    wanted = [(method, precision) for precision in options.precisions for method in chosen]

    reasons: dict[str, list[str]] = {}

    def leave_out(method: Method, precision: str, reason: str) -> None:
        document.put(key | {"method": method.name, "precision": precision, "reason": reason})
        reasons.setdefault(reason, []).append(f"{method.name} {precision}")

    missing: dict[tuple[Method, str], Step] = {}
    frames: list[Frame] = []
    try:
        fingerprint = source.fingerprint(spp)
    except InputError as error:
        for method, precision in wanted:
            leave_out(method, precision, str(error))
        wanted = []
    for method, precision in wanted:
        known = document.find(**key, method=method.name, precision=precision)
        if known and known["fingerprint"] == _of(method, fingerprint):
            continue
        if reason := method.unavailable(precision):
            leave_out(method, precision, reason)
            continue
        frames = frames or source.frames(spp)
        try:
            step = method.step(options.device, precision)
            with torch.inference_mode():
                warm_up(step, frames, options.device)
            missing[method, precision] = step
        except (InputError, RuntimeError) as error:  # torch and OIDN raise the latter where memory or a driver is short
            leave_out(method, precision, str(error).partition("\n")[0])
    for reason, names in reasons.items():
        say(f"{source.name}, {spp} spp: left out: {', '.join(names)}: {reason}")
    if not missing:
        return
    steps = {f"{method.name} {precision}": step for (method, precision), step in missing.items()}
    results = {r.method: r for r in evaluate(
        frames, steps, metrics=_measurable(), regions=ALL_REGIONS, device=options.device
    )}  # fmt: skip
    document.sequences[source.name] = document.sequences.get(source.name, {}) | _describe(source, frames)
    for method, precision in missing:
        result = results[f"{method.name} {precision}"]
        row = {"method": method.name, "precision": precision, "fingerprint": _of(method, fingerprint)}
        document.put(key | row | {"run": len(document.runs) - 1} | _numbers(result))
        if spp == source.spp and precision == "fp32":
            _keep_pictures(out, source, frames, method.name, result)
    say(f"{source.name}, {spp} spp: {len(steps)} methods on {len(frames)} frames")


def _measurable() -> tuple[str, ...]:
    """FLIP where it is installed (extra `bench`), and all the others."""
    return tuple(m for m in ALL_METRICS if m != "flip" or importlib.util.find_spec("flip_evaluator"))


def _of(method: Method, fingerprint: str) -> str:
    """Of an input and the weights that it goes through."""
    if not method.weights:
        return fingerprint
    return f"{fingerprint}-{hashlib.sha256(models.find(method.weights).read_bytes()).hexdigest()[:16]}"


def _numbers(result: Result) -> dict:
    first, median, third = np.percentile(result.times, [25, 50, 75]) * 1000
    return {
        "ms": {"median": median, "iqr": third - first, "steps": len(result.times)},
        "errors": result.errors,
        "ghost_length": result.ghost_length,
        "frames": result.frames,
    }


def _describe(source: Source, frames: list[Frame]) -> dict:
    masks = uncovered(frames)
    return {
        "path": str(source.folder),
        "size": list(source.base.size),
        "frames": [frame.number for frame in frames],
        "base_spp": source.spp,
        "sample_ms": source.sample_ms,
        "exposure": float(display_exposure(torch.cat([frame.reference for frame in frames]))),
        "uncovered_share": float(np.mean([mask.float().mean() for mask in masks[1:]] or [0.0])),
        "reference_relmse": reference_error(frames),
        "stills": [frames[i].number for i in stills(masks)],
    }


def stills(masks: list[torch.Tensor]) -> list[int]:
    """Which frames to look at: the one in which most is uncovered, else the last."""
    shares = [float(mask.float().mean()) for mask in masks]
    return [int(np.argmax(shares)) if max(shares) > 0 else len(masks) - 1]


def _keep_pictures(out: Path, source: Source, frames: list[Frame], method: str, result: Result) -> None:
    masks = uncovered(frames)
    for i in stills(masks):
        folder = out / "pictures" / source.name / f"{frames[i].number:04d}"
        folder.mkdir(parents=True, exist_ok=True)
        write_layers(folder / f"{method}.exr", {"color": _array(result.images[i])})
        truth = {"color": frames[i].reference, "motion": frames[i].motion, "uncovered": masks[i].float()}
        write_layers(folder / "reference.exr", {layer: _array(image) for layer, image in truth.items()})


def _array(image: torch.Tensor) -> np.ndarray:
    return image[0].permute(1, 2, 0).numpy()
