"""One loop for every method over every sequence: history, shots and look-ahead.

A *step* is `step(frame, history) -> (image, history)`; history None starts anew. A step with `delay` d looks d frames
ahead: it returns the image of the frame d before, and None for the first d frames of a shot. At the end of a shot it is
called with frame None until it has returned the remaining images.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import torch
from torch import Tensor

from .. import motion
from ..color import display_exposure, sampled_apart
from ..frame import Frame

HELD = 16  # frames in memory
Step = Callable[[Frame | None, Any], tuple[Tensor | None, Any]]


class Frames(Sequence[Frame]):
    """So many frames, each read when it is asked for; the latest `HELD` stay in memory."""

    def __init__(self, count: int, read: Callable[[int], Frame]) -> None:
        self._places, self._read = range(count), lru_cache(HELD)(read)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, i: int | slice) -> Frame | list[Frame]:
        place = self._places[i]
        return [self._read(p) for p in place] if isinstance(place, range) else self._read(place)

    @classmethod
    def of(cls, frames: Sequence[Frame]) -> Frames:
        """Themselves, if they are such."""
        return frames if isinstance(frames, cls) else cls(len(frames), frames.__getitem__)

    @cached_property
    def uncovered(self) -> list[Tensor]:
        """`uncovered` of all: found once, as every pass reads all frames."""
        return uncovered(self)

    @cached_property
    def exposure(self) -> Tensor:
        """Likewise."""
        return exposure(self)


@dataclass(frozen=True)
class Output:
    """One denoised frame."""

    frame: Frame
    image: Tensor  # [B, 3, H, W] linear radiance
    history: Any  # after the latest step
    seconds: float  # wall-clock time in `step` for one frame; the times of a shot's outputs add up to all of it


def outputs(step: Step, frames: Iterable[Frame], delay: int = 0, cuts: Collection[int] = ()) -> Iterator[Output]:
    """Denoise `frames` in order: one `Output` a frame, in the same order.

    A shot, and with it history None, begins at the first frame, after a gap in the frame numbers, and at every frame
    whose number is in `cuts`. Time is taken with the device synchronised before and after each step.
    """
    waiting: deque[Frame] = deque()  # frames whose image is yet to come
    history, before, ahead = None, None, 0.0  # ahead: seconds in steps that returned no image

    def advance(frame: Frame | None) -> Iterator[Output]:
        nonlocal history, ahead
        image, history, seconds = _timed(step, frame, history, waiting[0])
        if image is None:
            ahead += seconds
        else:
            yield Output(waiting.popleft(), image, history, seconds)

    def flush() -> Iterator[Output]:
        """The images at the end of a shot share their time and that of the steps without an image at its beginning: a
        step at the beginning takes in a frame and gives out none, a step at the end does the reverse."""
        nonlocal ahead
        late: list[Output] = []
        while waiting:
            left = len(waiting)
            late += advance(None)
            if len(waiting) == left:
                raise ValueError(f"{step}: returned no image at the end of a shot, with {left} frames to come")
        share = (ahead + sum(output.seconds for output in late)) / max(len(late), 1)
        ahead = 0.0
        yield from (replace(output, seconds=share) for output in late)

    for frame in frames:
        if before is not None and (frame.number > before + 1 or frame.number in cuts):
            yield from flush()
            history = None
        before = frame.number
        waiting.append(frame)
        yield from advance(frame)
        if len(waiting) > delay:
            raise ValueError(f"{step}: returned no image after {len(waiting)} frames; its delay is {delay}")
    yield from flush()


def uncovered(frames: Iterable[Frame]) -> list[Tensor]:
    """Occlusion mask of every frame, `[B, 1, H, W]` bool; empty for the first and without the previous
    `motion_next`."""
    masks, before = [], None
    for frame in frames:
        masks.append(motion.uncovered(frame, before))
        before = frame.motion_next
    return masks


def exposure(frames: Sequence[Frame]) -> Tensor:
    """`display_exposure` of all references, frames of one size; it holds no more of each than it looks at."""
    size = frames[0].reference.numel()
    apart = sampled_apart(len(frames) * size)
    starts = (-i * size % apart for i in range(len(frames)))
    sampled = [frame.reference.flatten()[i::apart].clone() for i, frame in zip(starts, frames, strict=True)]
    return display_exposure(torch.cat(sampled))


def _timed(step: Step, frame: Frame | None, history: Any, like: Frame) -> tuple[Tensor | None, Any, float]:
    _synchronise(like)
    started = time.perf_counter()
    image, history = step(frame, history)
    _synchronise(like)
    return image, history, time.perf_counter() - started


def _synchronise(frame: Frame) -> None:
    if frame.radiance.is_cuda:
        torch.cuda.synchronize(frame.radiance.device)
