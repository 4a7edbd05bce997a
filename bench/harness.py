"""What every benchmark shares: the correctness gate, timing in turn, and a JSON file that says where numbers are from.

The contract is in bench/README.md.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

# Before torch is loaded: its threads spin while they wait, which on a shared CPU can cost torch, and what is measured
# beside it, many times the work itself.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import numpy as np

ROOT = Path(__file__).parent.parent
sys.path.append(str(ROOT / "tests"))
from tolerances import TOLERANCES  # noqa: E402 (the one table of tolerances)

from rtdenoise.data.clips import ClipDataset  # noqa: E402
from rtdenoise.evaluate import evaluate  # noqa: E402
from rtdenoise.evaluate import origin as origins  # noqa: E402
from rtdenoise.files import dumps  # noqa: E402
from rtdenoise.frame import Frame  # noqa: E402


@dataclass(frozen=True)
class Timing:
    """Of one method: milliseconds a call."""

    median_ms: float
    iqr_ms: float  # between the first and the third quartile
    calls: int


def check(name: str, result: np.ndarray, reference: np.ndarray, tolerance: str) -> float:
    """The greatest absolute error of `result`. A method that is wrong gets no time: the program ends with 1."""
    relative, absolute = TOLERANCES[tolerance]
    error = np.abs(result.astype(np.float64) - reference)
    if result.shape != reference.shape or not (error <= absolute + relative * np.abs(reference)).all():
        sys.exit(f"{name} is wrong: greatest error {error.max():.3g}, not within '{tolerance}'. No times are reported.")
    return float(error.max())


def measure(
    methods: dict[str, Callable[[], object]],
    calls: int = 30,
    warmup: int = 3,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, Timing]:
    """Time the methods in turn, call by call, so that whatever else the machine does falls on all of them alike.

    Each must return only when its work is done (synchronise inside). `clock`: `time.process_time` for CPU time, which
    other processes do not lengthen.
    """
    seconds: dict[str, list[float]] = {name: [] for name in methods}
    for i in range(warmup + calls):
        for name, method in methods.items():
            start = clock()
            method()
            if i >= warmup:
                seconds[name].append(clock() - start)
    return {name: summary(values) for name, values in seconds.items()}


def summary(seconds: list[float]) -> Timing:
    """Of the calls of one method."""
    first, median, third = np.percentile(seconds, [25, 50, 75]) * 1000
    return Timing(round(median, 3), round(third - first, 3), len(seconds))


def origin(devices: dict[str, str]) -> dict[str, object]:
    """Where numbers come from, as `rtdenoise.evaluate.origin` says it, with the command that is running."""
    return origins.origin(" ".join(["python", *sys.argv]), devices)


def cpu() -> str:
    """The processor and how many threads torch uses of it."""
    return origins.device_name("cpu")


def write(path: Path, digits: int | None = None, **content: object) -> None:
    """Write a result as JSON, its numbers in so many significant digits, under a temporary name first. Timings become
    dictionaries."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(dumps(content, digits, indent=1, default=asdict) + "\n")
    temporary.replace(path)
    print(f"written: {path}")


def clips(folder: Path, count: int, signal: str) -> Iterator[list[Frame]]:
    """So many clips of a folder, evenly taken."""
    data = ClipDataset(folder)
    for index in np.linspace(0, len(data) - 1, min(count, len(data))).astype(int):
        yield data.load(int(index), signal=signal)


def mean_errors(
    step: Callable, sequences: Iterable[list[Frame]], metrics: Sequence[str], regions: Sequence[str]
) -> dict[str, dict[str, float]]:
    """region -> metric -> error as `evaluate` has it, mean over the sequences; one in which a region is empty does not
    count there."""
    found = [evaluate(frames, {"it": step}, metrics=metrics, regions=regions)[0].errors for frames in sequences]
    return {r: {m: float(np.nanmean([errors[r][m] for errors in found])) for m in metrics} for r in regions}


def insert_all(sections: dict[str, str], page: Path = ROOT / "docs" / "stability.md") -> None:
    """Put each text between `<!-- name -->` and `<!-- /name -->` of a document."""
    for name, text in sections.items():
        before, found, rest = page.read_text().partition(f"<!-- {name} -->\n")
        _, closed, after = rest.partition(f"<!-- /{name} -->")
        if not (found and closed):
            sys.exit(f"{page}: no <!-- {name} --> … <!-- /{name} -->")
        page.write_text(f"{before}{found}{text}\n{closed}{after}")
