"""The outcome of `denoise` and `combine`. Needs no torch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .plan import Plan

SUMMARY = "denoise.json"


@dataclass
class Summary:
    """The outcome of a run. All but `written`, `skipped` and `seconds` include earlier, interrupted runs."""

    written: int = 0
    skipped: int = 0
    seconds: float = 0.0  # in the denoiser alone
    replaced: dict[str, int] = field(default_factory=dict)  # "layer: what was wrong" -> pixels (`sanitise.faults`)
    passed_on: dict[str, int] = field(default_factory=dict)  # channel copied from the input -> NaNs in it
    cuts: list[int] = field(default_factory=list)  # numbers of the frames that start a shot
    exposure: list[float] = field(default_factory=list)  # brightness of each frame over that of its shot's first one
    gaps: list[tuple[int, int]] = field(default_factory=list)  # (first, last) missing frame number of each gap
    left_out: dict[str, int] = field(default_factory=dict)  # what -> frames that did without it
    notes: list[str] = field(default_factory=list)  # what else the user should know
    ran: dict[str, str] = field(default_factory=dict)  # backend, device and precision: what 'auto' became
    plan: Plan | None = None


def add(counts: dict[str, int], more: Mapping[str, int]) -> None:
    """Add to the counts of a summary."""
    for what, count in more.items():
        counts[what] = counts.get(what, 0) + count
