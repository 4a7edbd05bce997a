"""Looking ahead: each frame is denoised once the next few frames are there, too.

Frames after show what those before cannot: what was just uncovered, and as many samples again. A program in real time
shows its frames so many later; for frames on disk it costs little (docs/notes/lookahead.md). The network takes their
light as it takes that of the frames before, along the motion that leads back (`models.past.later`). The last of them
is not looked up: it has its say in the picture of the next frame, which settles this one (`models.settled`).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from ..frame import Frame

if TYPE_CHECKING:
    from torch import Tensor

    from .backends import Backend


SETTLES_FROM = 3  # frames ahead from which on the last one settles (docs/notes/settled.md)


def direct(backend: Backend, delay: int) -> int:
    """How many of `delay` frames after each one its step is given; the one beyond them settles its picture."""
    return delay - backend.settles


class Stepped(NamedTuple):
    """A frame that has been denoised."""

    frame: Frame
    image: Tensor
    after: Any  # the history


@dataclass(frozen=True)
class Lookahead:
    """A step that looks `delay` frames ahead, as `evaluate.sequence` takes it: the image of a frame comes so many
    frames later, and at the end of a shot for None."""

    backend: Backend
    delay: int

    def step(self, frame: Frame | None, history: Any = None) -> tuple[Tensor | None, Any]:
        """The image of the frame `delay` before; None for the first frames of a shot. The history holds the frames that
        wait for theirs, and the last one that has been denoised. Frames are prepared."""
        waiting, last = history or ((), None)
        if frame is not None:
            waiting = linked((*waiting, frame))
        while waiting and (frame is None or len(waiting) > direct(self.backend, self.delay)):
            (first, *following), before = waiting, last
            image, after = self.backend.denoise(first, before and before.after, tuple(following))
            waiting, last = tuple(following), Stepped(first, image, after)
            if not self.backend.settles:
                return image, (waiting, last)
            if before:
                return self.backend.settled(before.frame, before.after, first, after), (waiting, last)
        return (last.image, ((), None)) if frame is None else (None, (waiting, last))


def linked(frames: tuple[Frame, ...]) -> tuple[Frame, ...]:
    """Consecutive frames of a shot, the last one new, with `motion_next` in the one before that."""
    if len(frames) < 2:
        return frames
    from ..splat import completed

    *first, last, new = frames
    return (*first, completed(last, new), new)


class Delayed:
    """A backend's images, `delay` frames later across shots: one for each frame from there on."""

    def __init__(self, backend: Backend, delay: int) -> None:
        self._step, self._history = Lookahead(backend, delay), None
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
        except Exception:
            if self._history and (last := self._history[1]) and self._step.backend.settles:
                self._took(last.image)
            raise
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
