"""Every method that can be measured: what it is called, what it is, how it is started, and why it may be missing."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from ..baselines import Accumulate, Oidn, Svgf, Trmv
from ..errors import InputError
from ..frame import Frame
from ..models import available, load
from ..run.graphs import stepper
from ..sanitise import sanitise

Step = Callable[[Frame, object], tuple[Tensor, object]]
PRECISIONS = ("fp32", "bf16")


@dataclass(frozen=True)
class Method:
    """One row of a comparison. `start(device, precision)` gives a fresh `step`."""

    name: str
    what: str  # one line for a legend
    family: str  # input | accumulation | filter | oidn | network | ablation
    start: Callable[[str | torch.device, str], Step] | None  # None: not available, and `missing` says why
    missing: str = ""
    precisions: tuple[str, ...] = ("fp32",)
    weights: str = ""  # name or file of the weights it runs on

    def step(self, device: str | torch.device = "cpu", precision: str = "auto") -> Step:
        """A fresh step; 'auto' is the precision that suits the device. Raises InputError where there is none: why."""
        if reason := self.unavailable(precision):
            raise InputError(f"{self.name}: {reason}")
        return self.start(device, precision)

    def unavailable(self, precision: str = "auto") -> str:
        """Why it cannot run at that precision; empty where it can."""
        if self.start is None:
            return self.missing
        return "" if precision in ("auto", *self.precisions) else f"has no {precision} version"


def methods() -> dict[str, Method]:
    """All methods by name, the plainest first; networks are whatever weights are shipped."""
    found = [
        Method("noisy", "the input", "input", lambda device, precision: _noisy),
        Method("accumulate", "plain temporal accumulation", "accumulation",
               lambda device, precision: Accumulate().step),
        Method("accumulate-clamped", "accumulation, history clamped to the neighbourhood", "accumulation",
               lambda device, precision: Accumulate(clamp=0.5).step),
        Method("svgf", "SVGF (2017)", "filter", lambda device, precision: Svgf().step),
        Method("trmv", "SVGF on dual motion: TRMV (2021)", "filter", lambda device, precision: Trmv().step),
        *_oidn(),
        *(method for name in available() for method in _network(name)),
    ]  # fmt: skip
    return {method.name: method for method in found}


def choose(names: Iterable[str]) -> list[Method]:
    """The methods of these names, in that order, each once; all where there are none. NAME=FILE is the network of a
    weights file, under that name.

    Raises InputError for a name that is none, or is that of two methods, and for a file that is not there."""
    known, chosen = methods(), {}
    for name in names:
        method = _of_file(*name.split("=", 1)) if "=" in name else known.get(name)
        if method is None:
            raise InputError(f"unknown method {name!r}; expected NAME=FILE of weights, or some of {', '.join(known)}")
        same = chosen.setdefault(method.name, known.get(method.name, method))
        if same.weights != method.weights:
            raise InputError(f"{name}: another method is called {method.name!r}")
    return list((chosen or known).values())


def _oidn() -> list[Method]:
    kinds = {
        "oidn": ("OIDN, high quality", {}),
        "oidn-balanced": ("OIDN, balanced", {"quality": "balanced"}),
        "oidn-fast": ("OIDN, fast", {"quality": "fast"}),
        "oidn-prefiltered": ("OIDN, high, albedo and normal prefiltered", {"prefilter": True}),
        "oidn-on-accumulated": ("OIDN on the accumulated signal", {"accumulate": "input"}),
        "oidn-then-accumulated": ("OIDN, its output accumulated", {"accumulate": "output"}),
    }
    there = importlib.util.find_spec("pyoidn") is not None
    reason = "" if there else "needs pyoidn: pip install 'rtdenoise[bench]'"

    def start(options: dict, device: str | torch.device, precision: str) -> Step:
        return Oidn(**options).step

    return [
        Method(name, what, "oidn", partial(start, options) if there else None, reason)
        for name, (what, options) in kinds.items()
    ]


def _network(name: str) -> list[Method]:
    """Shipped weights, and what is left of them without dual motion and without history."""
    start = partial(_start, name)
    return [
        Method(name, f"rtdenoise {name}", "network", start, precisions=PRECISIONS, weights=name),
        Method(f"{name}-traditional", f"{name} on traditional motion, same weights", "ablation",
               partial(start, motion="traditional"), weights=name),
        Method(f"{name}-spatial", f"{name} without history: spatial kernels only", "ablation",
               partial(start, history=False), weights=name),
    ]  # fmt: skip


def _of_file(name: str, file: str) -> Method:
    """Weights that do not ship. Raises InputError for a file that is not there, and for a name that cannot be that of a
    picture."""
    if not re.fullmatch(r"[\w.-]*\w", name) or name == "reference":
        raise InputError(f"{name}={file}: expected a name of letters, digits, '-', '_' and '.', and not 'reference'")
    if not Path(file).is_file():
        raise InputError(f"{name}={file}: no such weights file")
    path = str(Path(file).absolute())  # never a shipped name
    return Method(name, f"the network of {file}", "network", partial(_start, path), precisions=PRECISIONS, weights=path)


def _start(weights: str, device: str | torch.device, precision: str, history: bool = True, **overrides: str) -> Step:
    step = stepper(load(weights, device, precision, **overrides))
    return step if history else partial(_without_history, step)


def _noisy(frame: Frame, history: None) -> tuple[Tensor, None]:
    return sanitise(frame).radiance, None


def _without_history(step: Step, frame: Frame, history: None) -> tuple[Tensor, None]:
    return step(frame, None)[0], None
