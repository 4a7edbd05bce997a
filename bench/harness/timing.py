"""The correctness gate, and timing in rotation."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .. import ROOT

sys.path.append(str(ROOT / "tests"))
from tolerances import TOLERANCES


@dataclass(frozen=True)
class Timing:
    """Milliseconds per call of one method."""

    median_ms: float
    iqr_ms: float  # third quartile minus first
    calls: int


def check(name: str, result: np.ndarray, reference: np.ndarray, tolerance: str) -> float:
    """Compare `result` with `reference` within a row of `tests/tolerances.py`; return the greatest absolute error.

    A wrong method gets no time: the program ends with exit code 1.
    """
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
    """Time the methods call by call in rotation, so that disturbances fall on all of them alike.

    A method must return only when its work is done: synchronise inside it. `clock` returns seconds;
    `time.process_time` counts CPU time, which other processes do not lengthen.
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
    """Median and interquartile range of one method's calls."""
    first, median, third = np.percentile(seconds, [25, 50, 75]) * 1000
    return Timing(round(median, 3), round(third - first, 3), len(seconds))
