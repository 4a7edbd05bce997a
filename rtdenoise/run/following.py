"""A backend whose history is as bright as the newest frame, where all light changes from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from itertools import chain, repeat
from typing import TYPE_CHECKING, Any

import numpy as np

from ..data.stored import BRIGHTNESS, GAINS
from ..errors import INSTALL_TORCH, InputError
from ..frame import Frame
from ..models.presets import Config
from .backends import Backend
from .plan import Plan

if TYPE_CHECKING:
    from ..brightness import Brightness


@dataclass(frozen=True)
class Followed:
    """A history of frames that were divided by their brightness."""

    inner: Any  # of the backend
    brightness: Brightness  # after the last frame
    gains: tuple[Any, ...]  # of the last frames of the shot, the newest first
    ahead: tuple[tuple[int, Brightness], ...] = ()  # number and brightness of frames that were ahead


def unfollowed(history: Any) -> Any:
    """The history of the backend alone."""
    return history.inner if isinstance(history, Followed) else history


@dataclass(frozen=True)
class Entered:
    """A step to take: what is given, divided by its brightness."""

    frame: Frame
    history: Any
    ahead: tuple[Frame, ...]
    brightness: Brightness | None = None  # None: as it was
    gains: tuple[Any, ...] = ()  # as in `Followed`
    coming: tuple[tuple[int, Brightness], ...] = ()  # number and brightness of the frames ahead

    def shown(self, image: Any) -> Any:
        """The image of the frame, of that of the step: a tensor or an array."""
        if self.brightness is None:
            return image
        return image * (self.brightness.value if isinstance(image, np.ndarray) else self.gains[0])

    def left(self, history: Any) -> Any:
        """The history after the step."""
        return history if self.brightness is None else Followed(history, self.brightness, self.gains, self.coming)


class Following:
    """A `Backend` around another. Where nothing is followed its histories are those of the other."""

    def __init__(self, inner: Backend, follows: bool) -> None:
        """It follows if it may, has PyTorch, and the network has a history."""
        self._inner = inner
        self._follows = follows and inner.config.motion is not None and find_spec("torch") is not None

    @property
    def config(self) -> Config:
        return self._inner.config

    @property
    def settles(self) -> bool:
        return self._inner.settles

    @property
    def ran(self) -> dict[str, str]:
        return self._inner.ran

    def plan(self, size: tuple[int, int], frames: int, first: list[Frame], left_out: dict[str, int]) -> Plan:
        return self._inner.plan(size, frames, first, left_out)

    def prepare(self, frame: Frame) -> Frame:
        return self._inner.prepare(frame)

    def mismatch(self, frame: Frame, history: Any) -> float:
        return self._inner.mismatch(frame, unfollowed(history))

    def enter(self, frame: Frame, history: Any, ahead: tuple[Frame, ...]) -> Entered:
        """A prepared frame, its history, and frames `ahead`, for a step of the backend."""
        if not self._follows:
            return Entered(frame, history, ahead)
        from ..brightness import followed

        last, gains, known = None, (), {}
        if isinstance(history, Followed):
            last, gains, known = history.brightness, history.gains, dict(history.ahead)
        found, frames = [], (frame, *ahead)
        for each in frames:
            last = known.get(each.number) or followed(each, last)
            found.append(last)
        first, *others = (its.divided(each) for its, each in zip(found, frames, strict=True))
        gains = found[0].of(frame), *gains[: self.config.recent]
        coming = tuple((each.number, its) for each, its in zip(ahead, found[1:], strict=True))
        return Entered(first, unfollowed(history), tuple(others), found[0], gains, coming)

    def step(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[np.ndarray, Any]:
        given = self.enter(frame, history, ahead)
        image, after = self._inner.step(given.frame, given.history, given.ahead)
        return given.shown(image), given.left(after)

    def denoise(self, frame: Frame, history: Any, ahead: tuple[Frame, ...] = ()) -> tuple[Any, Any]:
        given = self.enter(frame, history, ahead)
        image, after = self._inner.denoise(given.frame, given.history, given.ahead)
        return given.shown(image), given.left(after)

    def settled(self, frame: Frame, after: Any, following: Frame, after_following: Any) -> Any:
        if not isinstance(after, Followed):
            return self._inner.settled(frame, after, following, after_following)
        # Both pictures are divided by their own gains: as bright as each other.
        return after.gains[0] * self._inner.settled(frame, after.inner, following, after_following.inner)

    def gain(self, history: Any) -> float:
        """What the last frame, a single picture, was divided by."""
        return history.brightness.value if isinstance(history, Followed) else 1.0

    def save(self, history: Any) -> dict[str, np.ndarray]:
        if not isinstance(history, Followed):
            return self._inner.save(history)
        gains = np.float32([gain.item() for gain in history.gains]).reshape(1, -1, 1, 1)
        return self._inner.save(history.inner) | {BRIGHTNESS: history.brightness.stored(), GAINS: gains}

    def restore(self, fields: Mapping[str, np.ndarray]) -> Any:
        own = {name: fields[name] for name in (BRIGHTNESS, GAINS) if name in fields}
        inner = self._inner.restore({name: array for name, array in fields.items() if name not in own})
        if not (own and self._follows):
            if own and find_spec("torch") is None:
                raise InputError(f"its light was followed; {INSTALL_TORCH}")
            return inner
        if len(own) < 2:
            raise InputError(f"it holds {BRIGHTNESS} or {GAINS} alone")
        import torch

        from ..brightness import Brightness

        on_device = self.ran["backend"] == "torch"
        device = self.ran["device"] if on_device else "cpu"
        gains = np.split(own[GAINS], own[GAINS].shape[1], axis=1)
        brightness = Brightness.restored(own[BRIGHTNESS], float(gains[0].item()), device)
        return Followed(inner, brightness, tuple(torch.from_numpy(g).to(device) if on_device else g for g in gains))

    def remember(self, history: Any, frames: Sequence[Frame]) -> Any:
        if not isinstance(history, Followed):
            return self._inner.remember(history, frames)
        gains = chain(history.gains, repeat(1.0))  # frames before were not followed
        seen = [frame.divided(gain) for frame, gain in zip(frames, gains, strict=False)]
        return replace(history, inner=self._inner.remember(history.inner, seen))
