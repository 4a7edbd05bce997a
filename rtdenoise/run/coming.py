"""The frames of a sequence as `denoise` takes them: each prepared, and with those after it in its shot."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Self

from ..frame import MAX_CUT_MISMATCH, Frame, geometry
from ..sanitise import faults
from .backends import Backend
from .stand_ins import with_stand_ins


@dataclass(frozen=True)
class Coming:
    """A frame that has been read."""

    raw: Frame  # as it was read
    prepared: Any  # by the backend
    goes_on: bool  # with the shot of the frame before
    cut: bool  # it would, but for what it shows
    faults: dict[str, int]  # of the frame as it was read (`sanitise.faults`)


class Reader:
    """Reads on `lookahead` frames beyond the one to denoise. `seconds`: how long the backend took to prepare them.

    While a frame is denoised the next one is read in a thread, which ends with a `with` block. It is read once the one
    before is prepared: a backend may keep what was read last."""

    def __init__(
        self, read: Callable[[int], Frame], numbers: list[int], backend: Backend, lookahead: int, detect_cuts: bool
    ) -> None:
        """`numbers`: those of all frames."""
        self.seconds = 0.0
        self._read, self._numbers, self._backend = read, numbers, backend
        self._lookahead, self._detect_cuts = lookahead, detect_cuts
        self._waiting: list[Coming] = []
        self._thread = ThreadPoolExecutor(1, "rtdenoise-read")
        self._next: Future[tuple[Frame, dict[str, int]]] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._thread.shutdown(cancel_futures=True)

    def take(self, i: int, history: Any) -> tuple[Coming, tuple[Frame, ...]]:
        """Frame i, which comes after the last one taken, and those after it in its shot, prepared. `history`: after the
        frame before."""
        while len(self._waiting) <= self._lookahead and i + len(self._waiting) < len(self._numbers):
            self._add(i + len(self._waiting), history)
        this, *self._waiting = self._waiting
        end = next((k for k, other in enumerate(self._waiting) if not other.goes_on), len(self._waiting))
        return this, tuple(other.prepared for other in self._waiting[:end])

    def _examined(self, i: int) -> tuple[Frame, dict[str, int]]:
        """Frame i, and its faults."""
        frame = self._read(i)
        return frame, faults(frame)

    def _add(self, i: int, history: Any) -> None:
        """Take in frame i."""
        raw, found = self._next.result() if self._next else self._examined(i)
        started = time.perf_counter()
        prepared, last = self._backend.prepare(with_stand_ins(raw)), self._waiting[-1] if self._waiting else None
        if last is not None:
            history = geometry(last.prepared)
        follows = i > 0 and raw.number == self._numbers[i - 1] + 1
        goes_on = follows and history is not None and raw.motion is not None
        cut = goes_on and self._detect_cuts and self._backend.mismatch(prepared, history) > MAX_CUT_MISMATCH
        if last is not None and goes_on and not cut:
            from ..splat import completed

            self._waiting[-1] = replace(last, prepared=completed(last.prepared, prepared))
        self._waiting.append(Coming(raw, prepared, goes_on and not cut, cut, found))
        self.seconds += time.perf_counter() - started
        self._next = self._thread.submit(self._examined, i + 1) if i + 1 < len(self._numbers) else None
