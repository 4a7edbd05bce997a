"""Several processes for independent jobs."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from ..errors import InputError


def run_jobs(
    function: Callable,
    jobs: list[tuple],  # arguments of each call
    workers: int,
    start: Callable[..., None],  # called once in every process, before its first job; calls `end_with_parent`
    arguments: tuple = (),  # of `start`
    killed: str = "a process was killed (out of memory?); run the same command again with fewer --workers",
) -> Iterator:
    """Yield `(job, function(*job))` for every job in the order of completion, from `workers` processes.

    Raises what a job raises, and InputError with the text `killed` where a process was killed.
    """
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), start, arguments) as pool:
        running = {pool.submit(function, *job): job for job in jobs}
        try:
            for done in as_completed(running):
                yield running[done], done.result()
        except BrokenProcessPool as error:
            raise InputError(killed) from error
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def end_with_parent() -> None:
    """Exit this process as soon as its parent ends."""
    parent = multiprocessing.parent_process().sentinel
    threading.Thread(target=lambda: multiprocessing.connection.wait([parent]) and os._exit(1), daemon=True).start()
