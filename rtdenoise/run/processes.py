"""Independent jobs, somewhere: in processes of this machine, or on a Ray cluster (`farm.Farm`)."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Protocol

from ..errors import InputError


class Place(Protocol):
    """Where jobs run."""

    def run(self, function: Callable, jobs: list[tuple], start: Callable[[int], None], killed: str) -> Iterator:
        """Yield `(job, function(*job))` for every job, in the order of completion.

        Every process calls `start(threads)` before its first job, with the number of threads that it may use. What a
        job raises is raised here, and ends the others. So does InputError with the text `killed` where a process was
        killed and the job cannot be run again.
        """


@dataclass(frozen=True)
class Processes:
    """Processes of this machine."""

    count: int
    threads: int = 1  # of each

    def run(self, function: Callable, jobs: list[tuple], start: Callable[[int], None], killed: str) -> Iterator:
        """As `Place.run`; jobs of a killed process are not run again."""
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(self.count, spawn, _start, (start, self.threads)) as pool:
            running = {pool.submit(function, *job): job for job in jobs}
            try:
                for done in as_completed(running):
                    yield running[done], done.result()
            except BrokenProcessPool as error:
                raise InputError(killed) from error
            finally:
                pool.shutdown(wait=False, cancel_futures=True)


def _start(start: Callable[[int], None], threads: int) -> None:
    """Prepare a process: it ends with its parent, and without a traceback after Ctrl-C."""
    parent = multiprocessing.parent_process().sentinel
    threading.Thread(target=lambda: multiprocessing.connection.wait([parent]) and os._exit(1), daemon=True).start()
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    start(threads)
