"""Every method that can be measured: its name, a line about it, its start, and the reason if it is missing.

A new baseline is a class with `step` in `baselines/`, its export there, and a row in `methods`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from ..baselines import Accumulate, DeepCombiner, Oidn, Svgf, Trmv
from ..baselines.oidn import installed
from ..errors import InputError, did_you_mean
from ..files import fingerprint
from ..frame import Frame
from ..history import going_ahead
from ..models import STILLS, CombinerConfig, Shrinkage, available, available_combiners, load, load_combiner
from ..models.inference import INT8
from ..models.presets import SHRINKAGE
from ..models.shrinkage import corrected
from ..models.weights import bytes_beside, files_of, find, has_bytes, read_config, read_model
from ..run.graphs import stepper
from ..run.lookahead import Lookahead
from ..run.options import check_lookahead
from ..run.passes import InMemory, Passes
from ..run.pixel_filter import MODEL
from ..run.torch_backend import TorchBackend
from ..sanitise import sanitise
from .corrected import Corrected
from .sequence import Step

PRECISIONS = ("fp32", "bf16", INT8)
DEFAULTS = (  # measured if none is named
    "noisy", "accumulate", "svgf", "oidn", "paper", "fast", "default", "hybrid", "hybrid-ahead6",
)  # fmt: skip
ALL = "all"
AHEAD = re.compile(r"(.+)-ahead(\d+)")  # METHOD-aheadN: denoise --lookahead N
CORRECTED = ("oidn", "default")  # methods that 'all' also has with every combiner


@dataclass(frozen=True)
class Method:
    """One row of a comparison. `start(device, precision)` gives a fresh step."""

    name: str
    what: str  # one line for a legend
    family: str  # input | accumulation | filter | oidn | network | ablation
    start: Callable[[str | torch.device, str], Step] | None  # None: not available, and `missing` says why
    missing: str = ""
    precisions: tuple[str, ...] = ("fp32",)
    weights: tuple[str, ...] = ()  # names or files of the weights of its networks
    delay: int = 0  # frames that it looks ahead (`sequence.outputs`)

    def step(self, device: str | torch.device = "cpu", precision: str = "auto") -> Step:
        """A fresh step; 'auto' is the precision that suits the device. Raises InputError with the reason where the
        method is not available."""
        if reason := self.unavailable(precision):
            raise InputError(f"{self.name}: {reason}")
        return self.start(device, precision)

    def fingerprints(self) -> list[str]:
        """Of the files that hold its weights."""
        files = [file for weights in self.weights for file in files_of(find(weights))]
        return [fingerprint(file) for file in (*files, *bytes_beside(files))]

    def unavailable(self, precision: str = "auto") -> str:
        """Why the method cannot run at that precision; empty if it can."""
        if self.start is None:
            return self.missing
        return "" if precision in ("auto", *self.precisions) else f"has no {precision} version"


def methods() -> dict[str, Method]:
    """All methods by name, the plainest first; every shipped network is among them."""
    plain = {
        "noisy": ("the input", "input", lambda: _noisy),
        "accumulate": ("plain temporal accumulation", "accumulation", lambda: Accumulate().step),
        "accumulate-clamped": ("accumulation, history clamped to the neighbourhood", "accumulation",
                               lambda: Accumulate(clamp=0.5).step),
        "svgf": ("SVGF (2017)", "filter", lambda: Svgf().step),
        "trmv": ("SVGF on dual motion: TRMV (2021)", "filter", lambda: Trmv().step),
    }  # fmt: skip
    found = [
        *(Method(name, what, family, partial(_plain, start)) for name, (what, family, start) in plain.items()),
        *_oidn(),
        *(method for name in available() for method in _network(name)),
        _offline("offline", True),
        _offline("offline-without-oidn", False),
    ]
    for base in [method for method in found if method.name in CORRECTED]:
        found += [_corrected(base, combiner) for combiner in (SHRINKAGE, *available_combiners())]
    return {method.name: method for method in found}


def choose(names: Iterable[str]) -> list[Method]:
    """The methods of these names, in order, each once; `DEFAULTS` if there are none, every method for 'all'. NAME=FILE
    is the network of a weights file, under that name. METHOD+COMBINER is a method corrected by a combiner: `shrinkage`,
    a model that ships, a weights file, or dc:FILE for a deep combiner. METHOD-aheadN is a network that looks N frames
    ahead.

    Raises InputError for an unknown name, a name that stands for two methods, and a missing file.
    """
    known, chosen = methods(), {}
    asked = list(names) or [name for name in DEFAULTS if name in known or AHEAD.fullmatch(name)]
    for name in [n for a in asked for n in (known if a == ALL else [a])]:
        base, plus, combiner = name.partition("+")
        ahead = AHEAD.fullmatch(name)
        if plus and AHEAD.fullmatch(base):
            raise InputError(f"{name}: methods that look ahead are measured as they are; rtdenoise combine corrects "
                             "their frames")  # fmt: skip
        if plus and base in known and name not in known:
            if combiner != SHRINKAGE:
                find(combiner.removeprefix("dc:"), (SHRINKAGE, *available_combiners()))
            method = _corrected(known[base], combiner)
        elif ahead and ahead[1] in known:
            method = _ahead(known[ahead[1]], int(ahead[2]))
        else:
            method = _of_file(*name.split("=", 1)) if "=" in name else known.get(name)
        if method is None:
            raise InputError(f"unknown method {name!r}{did_you_mean(name, known)}; expected NAME=FILE of weights, or "
                             f"some of {', '.join(known)}")  # fmt: skip
        same = chosen.setdefault(method.name, known.get(method.name, method))
        if same.weights != method.weights:
            raise InputError(f"{name}: another method is called {method.name!r}")
    return list(chosen.values())


def _plain(start: Callable[[], Step], device: str | torch.device, precision: str) -> Step:
    return start()


def _oidn() -> list[Method]:
    kinds = {
        "oidn": ("OIDN, high quality", {}),
        "oidn-balanced": ("OIDN, balanced", {"quality": "balanced"}),
        "oidn-fast": ("OIDN, fast", {"quality": "fast"}),
        "oidn-prefiltered": ("OIDN, high, albedo and normal prefiltered", {"prefilter": True}),
        "oidn-on-accumulated": ("OIDN on the accumulated signal", {"accumulate": "input"}),
        "oidn-then-accumulated": ("OIDN, its output accumulated", {"accumulate": "output"}),
    }
    reason = _lacks_oidn()

    def start(options: dict, device: str | torch.device, precision: str) -> Step:
        return Oidn(**options).step

    return [
        Method(name, what, "oidn", None if reason else partial(start, options), reason)
        for name, (what, options) in kinds.items()
    ]


def _lacks_oidn() -> str:
    """Why OIDN cannot run; empty if it can."""
    return "" if installed() else "needs pyoidn: pip install 'rtdenoise[bench]'"


def _network(name: str) -> list[Method]:
    """The methods of shipped weights: unchanged, on traditional motion, and without history."""
    start, precisions = partial(_start, name), _precisions(find(name))
    alone = Method(name, f"rtdenoise {name}", "network", start, precisions=precisions, weights=(name,))
    if name in STILLS:
        return [alone]
    return [
        alone,
        Method(f"{name}-traditional", f"{name} on traditional motion, same weights", "ablation",
               partial(start, motion="traditional"), weights=(name,)),
        Method(f"{name}-corrected", f"denoise --correct with {name}", "network", partial(start, correct=True),
               precisions=precisions, weights=(name,)),
        Method(f"{name}-spatial", f"{name} without history: spatial kernels only", "ablation",
               partial(start, history=False), weights=(name,)),
    ]  # fmt: skip


def _ahead(base: Method, frames: int) -> Method:
    """A network that looks ahead. Raises InputError for other methods and numbers out of range."""
    check_lookahead(frames, f"{base.name}-ahead{frames}")
    if base.name not in available() or "mean" not in read_config(base.name).carries:
        raise InputError(f"{base.name}-ahead{frames}: expected a network that averages light")

    def start(device: str | torch.device, precision: str) -> Step:
        backend = TorchBackend(base.name, str(device), precision, lookahead=frames)
        step = Lookahead(backend, frames).step
        return lambda frame, history: step(frame and backend.prepare(frame), history)

    return replace(base, name=f"{base.name}-ahead{frames}", what=f"{base.what}, {frames} frames ahead", start=start,
                   delay=frames)  # fmt: skip


def _corrected(base: Method, combiner: str) -> Method:
    """A method whose frames a combiner corrects. Raises InputError if `combiner` names none."""
    weights, offsets, family, name = combiner.removeprefix("dc:"), DeepCombiner.offsets, "filter", combiner
    if combiner == SHRINKAGE:
        weights, make, what, offsets = "", partial(load_combiner, combiner), "shrunk residuals", Shrinkage().offsets
    elif combiner.startswith("dc:"):
        name, what = "dc", "Deep Combiner (2020)"
        make = lambda device, precision: DeepCombiner.load(weights).to(device)  # noqa: E731
    else:
        stored = read_model(combiner)
        if not isinstance(stored.config, CombinerConfig):
            raise InputError(f"{base.name}+{combiner}: {stored.path} is no combiner")
        name, family, offsets = stored.path.stem, "network", stored.config.offsets
        what = f"rtdenoise {name}"
        make = partial(load_combiner, combiner)

    def start(device: str | torch.device, precision: str) -> Step:
        return Corrected(base.step(device, precision), make(device, precision).combine, offsets).step

    return Method(
        f"{base.name}+{name}", f"{base.what}, corrected: {what}", family, start if base.start else None, base.missing,
        base.precisions, (*base.weights, *([weights] if weights else ())), delay=offsets[-1],
    )  # fmt: skip


def _of_file(name: str, file: str) -> Method:
    """Weights that do not ship. Raises InputError for a missing file, and for a name that no picture file can have."""
    if not re.fullmatch(r"[\w.-]*\w", name) or name in ("reference", ALL):
        raise InputError(f"{name}={file}: expected a name of letters, digits, '-', '_' and '.', and not 'reference' or "
                         f"{ALL!r}")  # fmt: skip
    if not Path(file).is_file():
        raise InputError(f"{name}={file}: no such weights file")
    path = str(Path(file).absolute())  # never a shipped name
    start, precisions = partial(_start, path), _precisions(Path(path))
    return Method(name, f"the network of {file}", "network", start, precisions=precisions, weights=(path,))


def _precisions(weights: Path) -> tuple[str, ...]:
    """Those in which the network of these weights runs."""
    return PRECISIONS if has_bytes(weights) else tuple(p for p in PRECISIONS if p != INT8)


def _start(
    weights: str, device: str | torch.device, precision: str, history: bool = True, correct: bool = False, **overrides
) -> Step:
    step = stepper(load(weights, device, precision, **overrides))
    step = corrected(step) if correct else step
    return going_ahead(step) if history else partial(_without_history, step)


def _offline(name: str, oidn: bool) -> Method:
    """`denoise --offline`, as it is with and without OIDN."""
    reason = _lacks_oidn() if oidn else ""

    def start(device: str | torch.device, precision: str) -> Step:
        return InMemory(Passes("hybrid", str(device), precision, oidn)).step

    what = f"denoise --offline: both directions in time, {'with' if oidn else 'without'} OIDN"
    weights = ("hybrid", MODEL)
    return Method(name, what, "network", None if reason else start, reason, weights=weights, delay=InMemory.delay)


def _noisy(frame: Frame, history: None) -> tuple[Tensor, None]:
    return sanitise(frame).radiance, None


def _without_history(step: Step, frame: Frame, history: None) -> tuple[Tensor, None]:
    return step(frame, None)[0], None
