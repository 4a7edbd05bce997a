"""`rtdenoise evaluate SEQ... --out DIR`: methods × precisions × samples per pixel, error and time in one run.

DIR/evaluation.json holds all numbers (`document.Document`), DIR/pictures/SEQ/FRAME/METHOD.exr the frames to look at.
What is in the file already is not run again, unless its input or its weights have changed.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from .. import models
from ..color import display_exposure
from ..data.exr import write_layers
from ..errors import InputError
from ..frame import Frame
from ..run.plan import make_plan
from ..sanitise import sanitise
from .document import NAME, Document
from .inputs import Source, reference_errors
from .measure import ALL_METRICS, ALL_REGIONS, WHOLE_METRICS, Result, evaluate, uncovered, warm_up
from .origin import LIBRARIES, device_name, origin, typed
from .registry import PRECISIONS, Method, Step, choose

MEASURED_WITH = (*LIBRARIES, "pyoidn", "scikit-image", "flip-evaluator", "pyfvvdp")
# Metric -> the module it needs, what pip installs for it.
NEEDS = {"flip": ("flip_evaluator", "'rtdenoise[bench]'"), "fovvideovdp": ("pyfvvdp", "pyfvvdp")}


@dataclass(frozen=True)
class Options:
    """What `run` measures."""

    methods: tuple[str, ...] = ()  # () : all
    precisions: tuple[str, ...] = ("fp32",)  # of PRECISIONS
    metrics: tuple[str, ...] = ()  # of ALL_METRICS and WHOLE_METRICS; () : ALL_METRICS, without those not installed
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
    if unknown := [name for name in options.metrics if name not in (*ALL_METRICS, *WHOLE_METRICS)]:
        raise InputError(f"unknown metric {unknown[0]!r}; expected some of {', '.join((*ALL_METRICS, *WHOLE_METRICS))}")
    for name in options.metrics:
        if name in NEEDS and not importlib.util.find_spec(NEEDS[name][0]):
            raise InputError(f"metric {name} needs a package that is not there: pip install {NEEDS[name][1]}")
    chosen = choose(options.methods)
    opened = [Source.open(folder, options.signal, options.preset, options.frames) for folder in sources]
    names = [source.name for source in opened]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"two sequences are called {twice[0]!r}: results go by the folder's name; rename one")
    document = _open_document(out, options.signal)
    document.methods |= {method.name: {"what": method.what, "family": method.family} for method in chosen}
    this_run = origin(typed(), {options.device: device_name(options.device)}, MEASURED_WITH)
    for source in opened:
        for spp in options.spp:
            _Input(document, source, spp, options, say).measure(chosen, out, this_run)
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


@dataclass
class _Input:
    """One sequence at one number of samples, and what is asked of it."""

    document: Document
    source: Source
    spp: int
    options: Options
    say: Callable[[str], None]
    reasons: dict[str, list[str]] = field(default_factory=dict)  # reason -> what is left out for it
    frames: list[Frame] = field(default_factory=list)  # read when the first method needs them

    @property
    def key(self) -> dict:
        return {"sequence": self.source.name, "spp": self.spp, "device": self.options.device}

    def measure(self, chosen: list[Method], out: Path, this_run: dict) -> None:
        """Run what is not in the document yet, all in turn, and put it there."""
        wanted = [(method, precision) for precision in self.options.precisions for method in chosen]
        steps = self._start(wanted)
        label = f"{self.source.name}, {self.spp} spp"
        for reason, names in self.reasons.items():
            self.say(f"{label}: left out: {', '.join(names)}: {reason}")
        if not steps:
            return
        results = evaluate(
            self.frames, {f"{method.name} {precision}": step for (method, precision), step in steps.items()},
            metrics=self._metrics, regions=ALL_REGIONS, device=self.options.device,
        )  # fmt: skip
        if this_run not in self.document.runs:
            self.document.runs.append(this_run)
        described = self.document.sequences.get(self.source.name, {}) | _describe(self.source, self.frames)
        self.document.sequences[self.source.name] = described
        if described["reference_psnr"] is None:
            self.say(f"{label}: no half references, so errors contain the references' noise: none of them corrected")
        for (method, precision), result in zip(steps, results, strict=True):
            row = {"method": method.name, "precision": precision, "fingerprint": self._fingerprint(method)}
            self.document.put(self.key | row | {"run": self.document.runs.index(this_run)} | _numbers(result))
            if self.spp == self.source.spp and precision == "fp32":
                _keep_pictures(out, self.source, self.frames, method.name, result)
        self.say(f"{label}: {len(steps)} methods on {len(self.frames)} frames")

    def _start(self, wanted: list[tuple[Method, str]]) -> dict[tuple[Method, str], Step]:
        """Steps of what is wanted, not known yet, and able to run; the rest is left out."""
        try:
            self.source.at(self.spp)
        except InputError as error:
            for method, precision in wanted:
                self._leave_out(method, precision, str(error))
            return {}
        steps = {}
        for method, precision in wanted:
            known = self.document.find(**self.key, method=method.name, precision=precision)
            if reason := method.unavailable(precision):
                self._leave_out(method, precision, reason)
            elif known is None or not self._covers(known, method):
                self.frames = self.frames or self.source.frames(self.spp)
                try:
                    step = method.step(self.options.device, precision)
                    with torch.inference_mode():
                        warm_up(step, self.frames, self.options.device)
                    steps[method, precision] = step
                except (InputError, RuntimeError) as error:  # the latter where memory or a driver is short
                    self._leave_out(method, precision, str(error).partition("\n")[0])
        return steps

    def _covers(self, known: dict, method: Method) -> bool:
        """Whether a result is of this input and these weights, and has all that is asked for."""
        return (
            known["fingerprint"] == self._fingerprint(method) and set(self._metrics) <= known["errors"]["frame"].keys()
        )

    def _leave_out(self, method: Method, precision: str, reason: str) -> None:
        self.document.put(self.key | {"method": method.name, "precision": precision, "reason": reason})
        self.reasons.setdefault(reason, []).append(f"{method.name} {precision}")

    @cached_property
    def _metrics(self) -> tuple[str, ...]:
        """What is asked for, or everything but FLIP where it is not installed (extra `bench`)."""
        installed = importlib.util.find_spec(NEEDS["flip"][0]) is not None
        return self.options.metrics or tuple(m for m in ALL_METRICS if m != "flip" or installed)

    @cached_property
    def _of_input(self) -> str:
        return self.source.fingerprint(self.spp)

    def _fingerprint(self, method: Method) -> str:
        """Of the input, and of the weights that it goes through."""
        if not method.weights:
            return self._of_input
        return f"{self._of_input}-{hashlib.sha256(models.find(method.weights).read_bytes()).hexdigest()[:16]}"


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
        "size": list(source.base.size),
        "frames": [frame.number for frame in frames],
        "base_spp": source.spp,
        "sample_ms": source.sample_ms,
        "exposure": float(display_exposure(torch.cat([frame.reference for frame in frames]))),
        "uncovered_share": float(np.mean([mask.float().mean() for mask in masks[1:]] or [0.0])),
        **reference_errors(frames),
        "stills": [frames[i].number for i in stills(masks)],
        "plan": make_plan(source.base.size, len(frames), "dual", [sanitise(frame) for frame in frames]).to_json(),
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
