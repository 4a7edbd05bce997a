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
    """`denoise`, then `combine` on windows of `offsets`, frame numbers relative to the corrected frame. The image of a
    frame comes `delay` frames later; the history holds the frames of the window."""

    denoise: Step
    combine: Callable[[Window], Combined]
    offsets: tuple[int, ...] = (0,)

    @property
    def delay(self) -> int:
        """Frames that the step looks ahead."""
        return self.offsets[-1]

    def step(self, frame: Frame | None, history: Any = None) -> tuple[Tensor | None, Any]:
        """The corrected image of the frame `delay` before `frame`; None as `sequence` says."""
        before, held = history or (None, ((None, None),) * len(self.offsets))
        item = None, None
        if frame is not None:
            image, before = self.denoise(frame, before)
            item = frame, image
        held, middle = (*held[1:], item), self.offsets.index(0)
        if frame is None:  # the end of a shot, whose first frame is yet to come where it is shorter than the delay
            early = next((i for i, (there, _) in enumerate(held[middle:]) if there is not None), 0)
            held = (*held[early:], *held[:early])
        window = Window(*zip(*held, strict=True))
        missing = window.frames[middle] is None
        return None if missing else self.combine(window).image, (before, held)
