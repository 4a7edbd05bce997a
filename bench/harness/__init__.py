"""Shared by all benchmarks: `timing` checks and times methods, `publish` writes results, `sequences` has frames,
`regions` the errors of their parts."""

from .command import run
from .publish import beside, cpu, insert_sections, publish, read, sets_kept, times_kept
from .regions import psnr_of_regions
from .sequences import clips, denoise, mean_errors, mural
from .timing import Timing, check, measure, summary

__all__ = [
    "Timing", "beside", "check", "clips", "cpu", "denoise", "insert_sections", "mean_errors", "measure", "mural",
    "psnr_of_regions", "publish", "read", "run", "sets_kept", "summary", "times_kept",
]  # fmt: skip
