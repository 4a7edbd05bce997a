"""Looking ahead: each frame is denoised once the next few frames are there, too.

Frames after show what those before cannot: what was just uncovered, and as many samples again. A program in real time
shows its frames so many later; for frames on disk it costs little (docs/notes/lookahead.md). The network takes their
light as it takes that of the frames before, along the motion that leads back (`models.past.later`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from ..frame import Frame
from ..splat import completed


@dataclass(frozen=True)
class Lookahead:
    """A step that looks `delay` frames ahead, as `evaluate.sequence` takes it: the image of a frame comes so many
    frames later, and at the end of a shot for None."""

    inner: Callable[[Frame, Any, tuple[Frame, ...]], tuple[Tensor, Any]]  # of frame, history and the frames after
    delay: int

    def step(self, frame: Frame | None, history: Any = None) -> tuple[Tensor | None, Any]:
        """The image of the frame `delay` before; None for the first frames of a shot. The history holds the frames that
        wait for theirs. Frames are sanitised."""
        waiting, before = history or ((), None)
        if frame is not None:
            waiting = linked((*waiting, frame))
            if len(waiting) <= self.delay:
                return None, (waiting, before)
        first, *following = waiting
        image, after = self.inner(first, before, tuple(following))
        return image, (tuple(following), after)


def linked(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    """Consecutive frames of a shot, the last one new, with `motion_next` in the one before that."""
    if len(frames) < 2:
        return frames
    *first, last, new = frames
    return (*first, completed(last, new), new)


class Delayed:
    """A backend's images, `delay` frames later across shots: one for each frame from there on."""

    def __init__(self, inner: Callable[..., tuple[Tensor, Any]], delay: int) -> None:
        """`inner`: as that of `Lookahead`."""
        self._step, self._history = Lookahead(inner, delay), None
        self._images: deque[Tensor] = deque()  # of frames whose turn has not come
        self._waiting = 0  # frames without an image

    def add(self, frame: Frame) -> Tensor | None:
        """Take in the next prepared frame of the shot; the image of the frame `delay` before, if there is one."""
        image, self._history = self._step.step(frame, self._history)
        self._waiting += 1
        if image is not None:
            self._took(image)
        return self._images.popleft() if self._waiting + len(self._images) > self._step.delay else None

    def end_shot(self) -> None:
        """The next frame has nothing to do with those so far. Where one of them cannot be denoised, it and those after
        it are given up."""
        try:
            while self._waiting:
                image, self._history = self._step.step(None, self._history)
                self._took(image)
        finally:
            self._waiting, self._history = 0, None

    @property
    def ready(self) -> int:
        """How many images are yet to come without further frames."""
        return len(self._images)

    def flush(self) -> list[Tensor]:
        """All images that are yet to come, in order. The next frame begins a shot."""
        self.end_shot()
        images = list(self._images)
        self._images.clear()
        return images

    def _took(self, image: Tensor) -> None:
        self._images.append(image)
        self._waiting -= 1
