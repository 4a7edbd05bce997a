"""Rendering processes: run jobs, yield results, tell in one line when a process dies or a folder is in use."""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from ..errors import InputError
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


@contextlib.contextmanager
def only_run(folder: Path, name: str) -> Iterator[None]:
    """Hold the lock `name` of a folder until the block or the process ends.

    Raises InputError where another process holds it. Systems without file locks hold nothing: two runs then render the
    same files twice.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    with (folder / f".lock-{name}").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(f"{folder}: another run is rendering into this folder; choose another --out") from error
        yield
