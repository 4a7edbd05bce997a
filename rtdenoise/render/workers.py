"""Rendering processes: run jobs, yield results, raise one line when a process dies or a folder is in use."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from pathlib import Path

from ..errors import InputError
from ..files import lock
from .stage import start_mitsuba


def run_jobs(function: Callable, jobs: list[tuple], workers: int) -> Iterator:
    """Yield `(job, function(*job))` for every job in the order of completion, from `workers` processes.

    Raises InputError where a job does, and where a process was killed.
    """
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), start_worker) as pool:
        running = {pool.submit(function, *job): job for job in jobs}
        try:
            for done in as_completed(running):
                yield running[done], done.result()
        except BrokenProcessPool as error:
            raise InputError(
                "a rendering process was killed (out of memory?); finished clips are kept: run the same command "
                "again, with fewer --workers if memory is short"
            ) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def start_worker() -> None:
    """Use one rendering thread, and exit as soon as the parent process ends."""
    parent = multiprocessing.parent_process().sentinel
    threading.Thread(target=lambda: multiprocessing.connection.wait([parent]) and os._exit(1), daemon=True).start()
    start_mitsuba(1)


def only_run(folder: Path, name: str) -> AbstractContextManager[None]:
    """Hold the lock `name` of a folder, as `files.lock` does."""
    return lock(folder, f".lock-{name}")
