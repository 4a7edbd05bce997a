"""Shared by all benchmarks: `timing` checks and times methods, `publish` writes results, `sequences` has frames."""

from .command import run
from .publish import beside, cpu, insert_sections, publish
from .sequences import clips, denoise, mean_errors, mural
from .timing import Timing, check, measure, summary

__all__ = [
    "Timing", "beside", "check", "clips", "cpu", "denoise", "insert_sections", "mean_errors", "measure", "mural",
    "publish", "run", "summary",
]  # fmt: skip
