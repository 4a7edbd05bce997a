"""One frame of an animation on disk: what the passes over the sequence know of it, and their combination.

The network runs over a sequence forward in time and backward. Read backward, a sequence is one whose `motion` and
`motion_next` have changed places. `combination` joins both passes, the frame alone and OIDN's two opinions; `sides`
corrects the result.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from ..baselines.oidn import Oidn, installed
from ..errors import InputError
from ..frame import Frame, History
from ..ops.even_sky import even_sky
from ..sanitise import sanitise
from ..splat import splat_motion_next
from .backends import TorchBackend
from .combination import Candidates, Combination, combine
from .moved import REACH, Seen, moved_mean
from .sides import Estimate, corrected, two_sided

WITHOUT_OIDN = "OIDN is not installed, so there is no second opinion: pip install pyoidn adds 0.6 dB and more"


class Passes:
    """The steps of both passes, and the combination. Frames are prepared once (`prepare`)."""

    def __init__(self, model: str = "default", device: str = "auto", precision: str = "auto") -> None:
        """Raises InputError for a model that keeps no running mean, and what loading it raises."""
        self.backend = TorchBackend(model, device, precision)
        if "mean" not in self.backend.config.carries:
            raise InputError(f"--offline: model {model!r} does not average light over time; choose default, many, "
                             "fast or quality")  # fmt: skip
        self.has_oidn = installed()
        self._oidn = Oidn(clean=True)

    @property
    def notes(self) -> list[str]:
        """What the user should know, a line each."""
        return [] if self.has_oidn else [WITHOUT_OIDN]

    @property
    def reach(self) -> int:
        """How many frames on each side `combine` looks at; without OIDN the next one alone, for `completed`."""
        return REACH if self.has_oidn else 1

    def step(self, frame: Frame, history: History | None) -> tuple[Estimate, Any]:
        """One step of a pass over prepared frames."""
        image, after = self.backend.step(frame, history)
        image = torch.from_numpy(image).to(frame.radiance.device)
        return Estimate(image, after.mean, after.mean_albedo, after.length, history is None), after

    @torch.inference_mode()
    def seen(self, frame: Frame, following: Seen | None = None) -> Seen:
        """A prepared frame, completed by the next one of its shot, with OIDN's picture of it."""
        frame = completed(frame, following and following.frame)
        if not self.has_oidn:
            return Seen(frame)
        clean = self._oidn.prefiltered(frame)
        return Seen(frame, clean, self._oidn.step(clean)[0])

    @torch.inference_mode()
    def combine(self, around: Around, forward: Estimate, backward: Estimate) -> Combination:
        """The best picture of a prepared frame."""
        frame, found = around.now.frame, combine(self.candidates(around, forward, backward))
        image = corrected(frame, found.image, forward, backward)
        return replace(found, image=even_sky(image, frame.radiance, frame.depth))  # OIDN filters the sky too

    def candidates(self, around: Around, forward: Estimate, backward: Estimate) -> Candidates:
        """What is known of a prepared frame."""
        frame, clean = around.now.frame, around.now.clean
        ours = forward.image, backward.image, self._single(frame, forward, backward)
        if clean is None:
            return Candidates(*ours)
        lights = two_sided(frame, forward, backward), moved_mean(around.now, around.before, around.after)
        opinions = (self._oidn.step(replace(clean, radiance=light))[0] for light in lights)
        return Candidates(*ours, around.now.picture, *opinions)

    def _single(self, frame: Frame, forward: Estimate, backward: Estimate) -> Tensor:
        """The network's image of the frame alone; a pass that begins here has it already."""
        for estimate in (forward, backward):
            if estimate.first:
                return estimate.image
        return torch.from_numpy(self.backend.step(frame, None)[0]).to(frame.radiance.device)


def completed(frame: Frame, following: Frame | None = None) -> Frame:
    """A frame with `motion_next`: where it has none, an approximate one from the next frame of the shot
    (`splat.splat_motion_next`), None at its end."""
    if frame.motion_next is not None or following is None:
        return frame
    return replace(frame, motion_next=splat_motion_next(following.motion, following.depth, frame.depth))


def reverse(frame: Frame) -> Frame:
    """A completed frame as the backward pass sees it: motion and motion_next have changed places."""
    return replace(frame, motion=frame.motion_next, motion_next=frame.motion)


def around(shot: Sequence[Seen], i: int) -> Around:
    """Frame i of a shot, with its neighbours."""
    return Around(shot[i], shot[max(0, i - REACH) : i][::-1], shot[i + 1 : i + 1 + REACH])


@dataclass(frozen=True)
class Around:
    """A frame with its neighbours in the shot, at most `moved.REACH` on each side, the nearest first."""

    now: Seen
    before: Sequence[Seen]
    after: Sequence[Seen]


class InMemory:
    """Both passes as a step with a delay (`evaluate.sequence`), for short sequences: it keeps the frames of a shot, and
    returns all images at its end."""

    delay = sys.maxsize

    def __init__(self, passes: Passes) -> None:
        self._passes = passes

    def step(self, frame: Frame | None, history: Shot | None) -> tuple[Tensor | None, Shot]:
        """None for a frame; the next image of the shot for None."""
        shot = history or Shot([], [], None)
        if frame is not None:
            frame = sanitise(frame)
            estimate, after = self._passes.step(frame, shot.history)
            return None, Shot([*shot.frames, frame], [*shot.estimates, estimate], after)
        images = shot.images or self._backward(shot)
        return images[0], replace(shot, images=images[1:])

    def _backward(self, shot: Shot) -> list[Tensor]:
        seen: list[Seen] = []
        for frame in reversed(shot.frames):
            seen.insert(0, self._passes.seen(frame, *seen[:1]))
        images, history = [], None
        for i in reversed(range(len(seen))):
            backward, history = self._passes.step(reverse(seen[i].frame), history)
            images.insert(0, self._passes.combine(around(seen, i), shot.estimates[i], backward).image)
        return images


@dataclass(frozen=True)
class Shot:
    """The state of `InMemory`."""

    frames: list[Frame]  # prepared
    estimates: list[Estimate]  # of the forward pass
    history: Any  # of the forward pass
    images: list[Tensor] = field(default_factory=list)  # yet to be returned
