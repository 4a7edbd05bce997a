"""What `rtdenoise evaluate` is asked to measure, and whether it can be."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from ..errors import InputError, did_you_mean
from .judge import ALL_METRICS, WHOLE_METRICS
from .registry import PRECISIONS

# Metric -> the module that it needs, and the package that pip installs for it.
NEEDS = {"flip": ("flip_evaluator", "'rtdenoise[bench]'"), "fovvideovdp": ("pyfvvdp", "pyfvvdp")}


@dataclass(frozen=True)
class EvaluateOptions:
    """The measurements that `run` makes."""

    methods: tuple[str, ...] = ()  # for `registry.choose`; (): its default
    precisions: tuple[str, ...] = ("fp32",)  # of PRECISIONS
    metrics: tuple[str, ...] = ()  # of ALL_METRICS and WHOLE_METRICS; (): those of ALL_METRICS that are installed
    spp: tuple[int, ...] = ()  # samples per pixel of the inputs; (): of the sequences themselves
    signal: str = "color"
    preset: str = "auto"
    frames: int | None = None  # at most this many of each sequence
    device: str = "cpu"
    references: tuple[str | Path, ...] = ()  # folders of converged frames, one a sequence; (): layers of the sequences

    @cached_property
    def chosen_metrics(self) -> tuple[str, ...]:
        """The metrics asked for, or all; without FLIP where it is not installed (extra `bench`)."""
        return self.metrics or tuple(filter(is_there, ALL_METRICS))

    def check(self, sources: Sequence[str | Path]) -> None:
        """Raise InputError for unknown metrics and precisions, no precision, metrics without their packages, and
        references that are not one for each of the `sources`."""
        if not self.precisions:
            raise InputError("--precision: name at least one")
        for kind, names, known in (
            ("precision", self.precisions, PRECISIONS),
            ("metric", self.metrics, (*ALL_METRICS, *WHOLE_METRICS)),
        ):
            for name in names:
                if name not in known:
                    raise InputError(f"unknown {kind} {name!r}{did_you_mean(name, known)}; expected some of "
                                     f"{', '.join(known)}")  # fmt: skip
        for name in self.metrics:
            if not is_there(name):
                raise InputError(f"metric {name} needs a package that is not there: pip install {NEEDS[name][1]}")
        if self.references and len(self.references) != len(sources):
            raise InputError(f"--reference: expected a folder for each of the {len(sources)} sequences, "
                             f"got {len(self.references)}")  # fmt: skip


def is_there(metric: str) -> bool:
    """Whether what a metric needs is installed."""
    return metric not in NEEDS or importlib.util.find_spec(NEEDS[metric][0]) is not None
