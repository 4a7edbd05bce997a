"""Rendering processes: one thread each, and one run at a time into a folder."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from ..files import lock
from .stage import start_mitsuba

KILLED = (
    "a rendering process was killed (out of memory?); finished clips are kept: run the same command again, with fewer "
    "--workers if memory is short"
)


def start_worker(threads: int) -> None:
    """Prepare a process that renders."""
    start_mitsuba(threads)


def only_run(folder: Path, name: str) -> AbstractContextManager[None]:
    """Hold the lock `name` of a folder, as `files.lock` does."""
    return lock(folder, f".lock-{name}")
