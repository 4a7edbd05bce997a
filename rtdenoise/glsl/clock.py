"""How long the stages of a frame take, on the GPU."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import moderngl


class Clock:
    """Times named stages with GL timer queries: what the GPU spends, not when the CPU asked for it.

    pipeline.clock = Clock(pipeline.ctx)
    pipeline.step(frame, history)
    pipeline.clock.read()      # {"upload": 0.0021, "network": 0.0143, …} seconds
    """

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._queries: list[tuple[str, moderngl.Query]] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Whatever GL is asked for inside counts as `name`. Stages may repeat, but not nest."""
        query = self._ctx.query(time=True)
        with query:
            yield
        self._queries.append((name, query))

    def read(self) -> dict[str, float]:
        """Seconds by stage since the last call, in order of their first appearance; waits for the GPU."""
        seconds: dict[str, float] = {}
        for name, query in self._queries:
            seconds[name] = seconds.get(name, 0.0) + query.elapsed * 1e-9
        self._queries.clear()
        return seconds
