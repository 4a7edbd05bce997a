"""`rtdenoise evaluate SEQ... --out DIR`: methods × precisions × samples per pixel, error and time in one run.

DIR/evaluation.json holds all numbers (`document.Document`), DIR/pictures/SEQ/FRAME/METHOD.exr the frames to look at,
DIR/playback/SEQ/METHOD.webp the sequences to play.
Results that the file holds already are kept, unless their input or their weights have changed. One that lacks a metric
is measured again, by the metrics that it had and by those asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import torch

from ..errors import InputError
from ..files import lock, remove_unfinished
from ..run.plan import make_plan
from ..sanitise import sanitise
from ..wording import counted
from .document import Document
from .inputs import Source, reference_errors
from .judge import ALL_METRICS, ALL_REGIONS, WHOLE_METRICS
from .measure import OnStep, Result, evaluate, warm_up
from .options import EvaluateOptions, is_there
from .origin import LIBRARIES, device_name, origin, typed
from .playback import MAX_FRAMES, keep_strip, shown, window
from .registry import Method, choose
from .sequence import Frames, Step
from .stills import keep_picture, keep_truth, stills

MEASURED_WITH = (*LIBRARIES, "pyoidn", "scikit-image", "flip-evaluator", "pyfvvdp")


def run(
    sources: Sequence[str | Path],
    out: Path,
    options: EvaluateOptions,
    say: Callable[[str], None] = print,
    on_step: OnStep = lambda label, done, total: None,
) -> Document:
    """Measure, and write after every input. An input, a method or a precision that is missing is skipped with its
    reason. `say` gets a line for each input, `on_step` the running method (`measure.evaluate`).

    Raises InputError for unknown methods, metrics and precisions, and for sequences that cannot be measured.
    """
    options.check(sources)
    chosen = choose(options.methods)
    references = options.references or [None] * len(sources)
    opened = [
        Source.open(folder, options.signal, options.preset, options.frames, reference)
        for folder, reference in zip(sources, references, strict=True)
    ]
    names = [source.name for source in opened]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two sequences are called {twice[0]!r}: results go by the folder's name; rename one")
    out.mkdir(parents=True, exist_ok=True)
    with lock(out):
        remove_unfinished(out, inside=True)
        return _measure(opened, chosen, out, options, say, on_step)


def _measure(
    opened: Sequence[Source],
    chosen: list[Method],
    out: Path,
    options: EvaluateOptions,
    say: Callable[[str], None],
    on_step: OnStep,
) -> Document:
    document = Document.open(out, options.signal)
    document.methods |= {method.name: {"what": method.what, "family": method.family} for method in chosen}
    this_run = origin(typed(), {options.device: device_name(options.device)}, MEASURED_WITH)
    for source in opened:
        for spp in options.spp or (source.spp,):
            _Input(document, source, spp, options, say, on_step).measure(chosen, out, this_run)
            document.write(out)
    return document


@dataclass
class _Input:
    """One sequence at one number of samples per pixel, and its requested measurements."""

    document: Document
    source: Source
    spp: int
    options: EvaluateOptions
    say: Callable[[str], None]
    on_step: OnStep
    reasons: dict[str, list[str]] = field(default_factory=dict)  # reason -> names of the methods left out for it
    frames: Frames | None = None  # opened when the first method needs them

    @property
    def key(self) -> dict:
        return {"sequence": self.source.name, "spp": self.spp, "device": self.options.device}

    @property
    def label(self) -> str:
        return f"{self.source.name}, {self.spp} spp"

    def measure(self, chosen: list[Method], out: Path, this_run: dict) -> None:
        """Measure the methods whose results the document lacks, all in turn, and add them."""
        steps = self._start([(method, precision) for precision in self.options.precisions for method in chosen])
        for reason, names in self.reasons.items():
            self.say(f"{self.label}: left out: {', '.join(names)}: {reason}")
        if self.source.name in self.document.sequences:  # samples.json may have come, or changed
            self.document.sequences[self.source.name]["sample_ms"] = self.source.sample_ms
        if not steps:
            return
        described = self.document.sequences.get(self.source.name, {})
        pictured = self.spp == self.source.spp  # pictures are of these frames
        if pictured or not described:
            described = described | _describe(self.source, self.frames)
        results = evaluate(
            self.frames, {f"{method.name} {precision}": step for (method, precision), step in steps.items()},
            metrics=self._metrics_of(steps), regions=ALL_REGIONS, device=self.options.device,
            delays={f"{method.name} {precision}": method.delay for method, precision in steps},
            on_step=lambda name, done, total: self.on_step(f"{self.label}: {name}", done, total),
            keep=partial(self._kept, described) if pictured else lambda i, image: None,
        )  # fmt: skip
        if this_run not in self.document.runs:
            self.document.runs.append(this_run)
        self.document.sequences[self.source.name] = described
        if described.get("reference_psnr") is None:
            self.say(f"{self.label}: no half references, so errors contain the references' noise: none is corrected")
        for (method, precision), result in zip(steps, results, strict=True):
            row = {"method": method.name, "precision": precision, "fingerprint": self._fingerprint(method)}
            self.document.put(self.key | row | {"run": self.document.runs.index(this_run)} | _numbers(result))
            if pictured and precision == self.document.pictured(self.source.name, method.name)["precision"]:
                self._keep_strip(out, method.name, [part for part, _ in result.images if part is not None])
                for number, (_, still) in zip(self.source.base.numbers, result.images, strict=False):
                    if still is not None:
                        keep_picture(out, self.source, number, method.name, still)
        if pictured:
            first = range(min(MAX_FRAMES, len(self.frames)))
            parts = [self._kept(described, i, self.frames[i].reference)[0] for i in first]
            self._keep_strip(out, "reference", parts)
            for i in map(self.source.base.numbers.index, described["stills"]):
                keep_truth(out, self.source, self.frames[max(0, i - 1) : i + 1])
        self.say(f"{self.label}: {counted(len(steps), 'method')} on {counted(len(self.frames), 'frame')}")
        if others := sorted({row["method"] for row in self.document.results if self._is_of_others(row)}):
            self.say(f"{self.label}: results of {', '.join(others)} are of other frames, or of these before they "
                     "changed: name them, too, to measure them again")  # fmt: skip

    def _kept(self, described: dict, i: int, image: torch.Tensor) -> tuple[np.ndarray | None, torch.Tensor | None]:
        """What is kept of the image of frame i: its part of the strip, and the image where it is a still."""
        number, playback = self.source.base.numbers[i], described["playback"]
        part = shown(image, playback["window"], described["exposure"]) if number in playback["frames"] else None
        return part, image if number in described["stills"] else None

    def _keep_strip(self, out: Path, name: str, parts: list[np.ndarray]) -> None:
        keep_strip(out / "playback" / self.source.name / f"{name}.webp", parts)

    def _start(self, wanted: list[tuple[Method, str]]) -> dict[tuple[Method, str], Step]:
        """Steps of the methods that have no result yet and can run; the others are left out."""
        try:
            self.source.at(self.spp)
        except InputError as error:
            for method, precision in wanted:
                self._leave_out(method, precision, str(error))
            return {}
        steps = {}
        for method, precision in wanted:
            known = self._known(method, precision)
            if known and set(self.options.chosen_metrics) <= known["errors"]["frame"].keys():
                continue
            if reason := method.unavailable(precision):
                self._leave_out(method, precision, reason)
            else:
                self.frames = self.frames or self.source.frames(self.spp)
                try:
                    step = method.step(self.options.device, precision)
                    with torch.inference_mode():
                        warm_up(step, self.frames, self.options.device, method.delay)
                    steps[method, precision] = step
                except (InputError, RuntimeError, MemoryError) as error:  # RuntimeError: out of memory, a driver
                    self._leave_out(method, precision, str(error).partition("\n")[0] or "out of memory")
        return steps

    def _known(self, method: Method, precision: str) -> dict | None:
        """The result with this input and these weights."""
        row = self.document.find(**self.key, method=method.name, precision=precision)
        return row if row is not None and row["fingerprint"] == self._fingerprint(method) else None

    def _metrics_of(self, steps: Iterable[tuple[Method, str]]) -> tuple[str, ...]:
        """The metrics asked for, and those of the results that are measured again."""
        rows = [row for step in steps if (row := self._known(*step))]
        had = {metric for row in rows for metric in row["errors"]["frame"] if is_there(metric)}
        return tuple(m for m in (*ALL_METRICS, *WHOLE_METRICS) if m in self.options.chosen_metrics or m in had)

    def _is_of_others(self, row: dict) -> bool:
        """Whether a result under this sequence's name is of an input that it no longer has."""
        same = all(row[key] == value for key, value in self.key.items())
        return same and not row["fingerprint"].startswith(self._of_input)

    def _leave_out(self, method: Method, precision: str, reason: str) -> None:
        if not self._known(method, precision):
            self.document.put(self.key | {"method": method.name, "precision": precision, "reason": reason})
        self.reasons.setdefault(reason, []).append(f"{method.name} {precision}")

    @cached_property
    def _of_input(self) -> str:
        return self.source.fingerprint(self.spp)

    def _fingerprint(self, method: Method) -> str:
        """Changes with the input and with the weights."""
        return "-".join([self._of_input, *method.fingerprints()])


def _numbers(result: Result) -> dict:
    first, median, third = np.percentile(result.times, [25, 50, 75]) * 1000
    return {
        "ms": {"median": median, "iqr": third - first, "steps": len(result.times)},
        "errors": result.errors,
        "ghost_length": result.ghost_length,
        "frames": result.frames,
    }


def _describe(source: Source, frames: Frames) -> dict:
    masks, numbers = frames.uncovered, list(source.base.numbers[: len(frames)])
    clean = Frames(len(frames), lambda i: sanitise(frames[i]))
    return {
        "size": list(source.base.size),
        "frames": numbers,
        "base_spp": source.spp,
        "sample_ms": source.sample_ms,
        "exposure": float(frames.exposure),
        "uncovered_share": float(np.mean([mask.float().mean() for mask in masks[1:]] or [0.0])),
        **reference_errors(frames),
        "playback": {"window": window(masks), "frames": numbers[:MAX_FRAMES]},
        "stills": [numbers[i] for i in stills(masks)],
        "plan": make_plan(source.base.size, len(frames), "dual", clean).to_json(),
    }
