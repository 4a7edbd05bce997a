"""Files are written in a thread, behind the frame that is denoised meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Self


class Behind:
    """One job at a time in a thread. After a `with` block all jobs have ended, also where the block fails: what was
    begun is finished, as by a run that is interrupted."""

    def __init__(self, done: Callable[[Any], None]) -> None:
        """`done` is called with the result of each job, by `wait`."""
        self._done = done
        self._thread = ThreadPoolExecutor(1, "rtdenoise-write")
        self._job: Future[Any] | None = None

    def start(self, job: Callable[[], Any]) -> None:
        """Begin a job once the one before has ended (`wait`)."""
        self.wait()
        self._job = self._thread.submit(job)

    def wait(self) -> None:
        """Until the job has ended. Raises what it raised."""
        job, self._job = self._job, None
        if job:
            self._done(job.result())

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            if kind is None:
                self.wait()
        finally:
            self._thread.shutdown()
