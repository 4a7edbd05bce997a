"""The frames of a sequence as `denoise` takes them: each prepared, and with those after it in its shot."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from ..frame import MAX_CUT_MISMATCH, Frame, geometry
from .backends import Backend
from .options import Options
from .stand_ins import with_stand_ins

if TYPE_CHECKING:
    from ..brightness import Brightness


def follows_exposure(options: Options, backend: Backend) -> bool:
    """Whether frames are divided by their brightness (`brightness`)."""
    in_parts = options.lights or options.also
    wanted = options.detect_exposure and not in_parts and backend.config.motion is not None
    return wanted and find_spec("torch") is not None


@dataclass(frozen=True)
class Coming:
    """A frame that has been read."""

    raw: Frame  # as it was read
    prepared: Any  # by the backend, and divided by its brightness
    goes_on: bool  # with the shot of the frame before
    cut: bool  # it would, but for what it shows
    brightness: Brightness | None  # None where it is not asked for

    @property
    def gain(self) -> float:
        """What the frame was divided by."""
        return self.brightness.value if self.brightness else 1.0


class Reader:
    """Reads on `lookahead` frames beyond the one to denoise. `seconds`: how long the backend took to prepare them."""

    def __init__(
        self,
        read: Callable[[int], Frame],
        numbers: list[int],
        backend: Backend,
        options: Options,
        brightness: Brightness | None = None,
    ) -> None:
        """`numbers`: those of all frames. `brightness`: after the last frame that an earlier run has denoised."""
        self.seconds = 0.0
        self._read, self._numbers, self._backend = read, numbers, backend
        self._lookahead, self._detect_cuts = options.lookahead, options.detect_cuts
        self._follows, self._brightness = follows_exposure(options, backend), brightness
        self._waiting: list[Coming] = []

    def take(self, i: int, history: Any) -> tuple[Coming, tuple[Frame, ...]]:
        """Frame i, which comes after the last one taken, and those after it in its shot, prepared. `history`: after the
        frame before."""
        while len(self._waiting) <= self._lookahead and i + len(self._waiting) < len(self._numbers):
            self._add(i + len(self._waiting), history)
        this, *self._waiting = self._waiting
        end = next((k for k, other in enumerate(self._waiting) if not other.goes_on), len(self._waiting))
        return this, tuple(other.prepared for other in self._waiting[:end])

    def _add(self, i: int, history: Any) -> None:
        """Read frame i."""
        raw = self._read(i)
        started = time.perf_counter()
        prepared, last = self._backend.prepare(with_stand_ins(raw)), self._waiting[-1] if self._waiting else None
        if last is not None:
            history = geometry(last.prepared)
        follows = i > 0 and raw.number == self._numbers[i - 1] + 1
        goes_on = follows and history is not None and raw.motion is not None
        cut = goes_on and self._detect_cuts and self._backend.mismatch(prepared, history) > MAX_CUT_MISMATCH
        goes_on = goes_on and not cut
        if self._follows:
            from ..brightness import followed

            self._brightness = followed(prepared, self._brightness if goes_on else None)
            prepared = self._brightness.divided(prepared)
        if last is not None and goes_on:
            from ..splat import completed

            self._waiting[-1] = replace(last, prepared=completed(last.prepared, prepared))
        self._waiting.append(Coming(raw, prepared, goes_on, cut, self._brightness))
        self.seconds += time.perf_counter() - started
