"""Rendering processes: run jobs, yield results, raise one line when a process dies or a folder is in use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from ..files import lock
from ..run import processes
from .stage import start_mitsuba

KILLED = (
    "a rendering process was killed (out of memory?); finished clips are kept: run the same command again, with fewer "
    "--workers if memory is short"
)


def run_jobs(function: Callable, jobs: list[tuple], workers: int) -> Iterator:
    """`processes.run_jobs` in processes that render."""
    return processes.run_jobs(function, jobs, workers, start_worker, killed=KILLED)


def start_worker() -> None:
    """Use one rendering thread, and exit as soon as the parent process ends."""
    processes.end_with_parent()
    start_mitsuba(1)


def only_run(folder: Path, name: str) -> AbstractContextManager[None]:
    """Hold the lock `name` of a folder, as `files.lock` does."""
    return lock(folder, f".lock-{name}")
