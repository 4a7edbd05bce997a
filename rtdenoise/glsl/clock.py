"""Times of the stages of a frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl

from ..constants import SOFTWARE_RENDERER
from .current import current


class Clock:
    """Times named stages on the GPU, by GL timer queries.

        pipeline.clock = Clock(pipeline.ctx)
        pipeline.step(frame, history)
        pipeline.clock.read()      # {"upload": 0.0021, "features": 0.0003, …} seconds

    Mesa's software renderer returns nonsense for them: there the clock waits for each stage and times it on the CPU.
    """

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._software = SOFTWARE_RENDERER in ctx.info["GL_RENDERER"]
        self._queries: list[tuple[str, moderngl.Query]] = []
        self._seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Commands issued inside count as `name`. Stages may repeat, but not nest."""
        self._seconds.setdefault(name, 0.0)
        if self._software:
            self._ctx.finish()
            started = time.perf_counter()
            yield
            self._ctx.finish()
            self._seconds[name] += time.perf_counter() - started
            return
        query = self._ctx.query(time=True)
        with query:
            yield
        self._queries.append((name, query))

    def read(self) -> dict[str, float]:
        """Seconds by stage since the last call, in order of their first appearance; waits for the GPU."""
        with current(self._ctx):
            for name, query in self._queries:
                self._seconds[name] += query.elapsed * 1e-9
        seconds, self._seconds = self._seconds, {}
        self._queries.clear()
        return seconds
