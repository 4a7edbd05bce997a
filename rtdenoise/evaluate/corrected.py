"""A method whose frames a combiner corrects, as one step with a delay (`sequence`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ..frame import Frame
from ..models import Combined, Window
from .sequence import Step


@dataclass(frozen=True)
class Corrected:
    """`denoise`, and then `combine` on windows of `offsets`, frame numbers relative to the corrected frame. The image
    of a frame comes `delay` frames later; the history holds what the window still needs."""

    denoise: Step
    combine: Callable[[Window], Combined]
    offsets: tuple[int, ...] = (0,)

    @property
    def delay(self) -> int:
        """Frames that it looks ahead."""
        return self.offsets[-1]

    def step(self, frame: Frame | None, history: Any = None) -> tuple[Tensor | None, Any]:
        """Of the frame `delay` before the image; None as `sequence` has it."""
        before, held = history or (None, ((None, None),) * len(self.offsets))
        item = None, None
        if frame is not None:
            image, before = self.denoise(frame, before)
            item = frame, image
        held = (*held[1:], item)
        window = Window(*zip(*held, strict=True))
        missing = window.frames[self.offsets.index(0)] is None
        return None if missing else self.combine(window).image, (before, held)
