"""One frame of an animation on disk: what the passes over the sequence know of it, and their combination.

The network runs over a sequence forward in time and backward. Read backward, a sequence is one whose `motion` and
`motion_next` have changed places. `combination` joins both passes, the frame alone and a second opinion.

OIDN filters what both passes have seen in each pixel; where it is not installed, the networks of `pixel_filter` do,
which are as OIDN's, but smaller for albedo and normal. Where one frame has seen a pixel, and more have seen those
around, noise is uneven: much in what was just uncovered, little around it, and they take that for texture. So the frame
is first filtered by itself, which is as noisy everywhere, and that picture stands in for such pixels:

    opinion = filter(a · seen on both sides + (1 - a) · filter(frame)),
    1 - a = clamp(1 - m, 0, 1) · clamp(mean m / EVENED_FROM, 0, 1),    m: frames beside this one; over AROUND² pixels

At edges that move, more frames have seen albedo and normal than light (`covered`); both have an `a` of their own.
In the end each picture takes some of those of the frames beside it.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from ..baselines.oidn import Oidn, installed
from ..errors import InputError
from ..frame import Frame, History, reverse
from ..history import advanced
from ..models.accumulated_kpn import AccumulatedKPN
from ..models.hybrid import Hybrid
from ..models.settled import approached, mixed
from ..models.window import box
from ..ops import reproject
from ..ops.even_sky import even_sky
from ..ops.fireflies import without_fireflies
from ..ops.kept import nearer
from ..ops.recall import FOOTPRINT
from ..sanitise import sanitise
from ..splat import completed_shot
from .combination import Candidates, combine
from .combined import Beside, Combined
from .covered import as_covered
from .pixel_filter import PixelFilter
from .sides import Estimate, seen_on_both_sides
from .torch_backend import TorchBackend

AROUND, EVENED_FROM = 15, 2.0  # pixels, odd; frames beside this one, from which on a pixel of none is wholly evened
LEFT_TO_KERNELS = 0.4  # of the share that a network's written pixels have in real time: the filter writes pixels, too
WITHOUT_OIDN = "OIDN is not installed: a smaller filter takes its place, for 0.05 dB less, in less time"


class Passes:
    """The steps of both passes, and the combination. Frames are prepared once (`prepare`)."""

    def __init__(
        self, model: str = "hybrid", device: str = "auto", precision: str = "auto", oidn: bool | None = None
    ) -> None:
        """`oidn`: whether that filters; None: where it is installed. 'auto' is float32.
        Raises InputError for a model that averages no light, and what loading it raises."""
        self.has_oidn = installed() if oidn is None else oidn
        precision = "fp32" if precision == "auto" else precision  # steps of fewer bits show where little noise is left
        self.backend = TorchBackend(model, device, precision, footprint=True)
        network = self.backend.network
        if not isinstance(network, AccumulatedKPN):
            raise InputError(f"--offline: model {model!r} does not average light over time; choose hybrid, default, "
                             "many or fast")  # fmt: skip
        self.keeps_fireflies = not isinstance(network, Hybrid) or network.keeps_fireflies
        if isinstance(network, Hybrid):
            kernels, *others = network.shares
            network.shares = kernels + LEFT_TO_KERNELS * (1 - kernels), *others
        self._filter = Oidn(clean=True) if self.has_oidn else PixelFilter(self.backend.device, precision)

    @property
    def notes(self) -> list[str]:
        """What the user should know, a line each."""
        return [] if self.has_oidn else [WITHOUT_OIDN]

    def step(self, frame: Frame, history: History | None) -> tuple[Estimate, Any]:
        """One step of a pass over prepared frames."""
        image, after = self.backend.denoise(frame, history)
        footprint, surface_count = as_covered(frame, history, after)
        seen = footprint, after.footprint_count, surface_count
        return Estimate(image, history is None, *seen, after.trusted), after

    @torch.inference_mode()
    def combine(self, frame: Frame, forward: Estimate, backward: Estimate) -> Combined:
        """The best picture of a prepared frame by itself."""
        found = combine(self.candidates(frame, forward, backward))
        image = found.image
        if not self.keeps_fireflies:
            known = (forward.footprint_count + backward.footprint_count - 2).clamp(0, 1)  # by the frames beside it
            image = without_fireflies(image, frame.depth, frame.normal, known)
        image = even_sky(image, frame.radiance, frame.depth)  # it is filtered, too
        return Combined(image, found.spread, forward.trusted, backward.trusted)

    @torch.inference_mode()
    def settle(self, frame: Frame, own: Combined, before: Beside | None, after: Beside | None) -> Tensor:
        """The picture of a prepared frame with those of the frames beside it in its shot (`models.settled`),
        `[1, 3, H, W]`."""
        image, here = own.image, (frame.depth, frame.normal)  # of the lookups below only counts where they found it
        if after is not None:
            surface = nearer(frame.depth, advanced(after.frame, frame)), frame.normal
            _, same = reproject(own.after, frame.motion_next, surface, (after.frame.depth, after.frame.normal))
            same = same & ~approached(surface[0], after.frame.depth, frame.motion_next)
            image = mixed(image, frame.radiance, after.image, frame.motion_next, same * own.after, own.before)
        if before is not None:
            there = nearer(before.frame.depth, advanced(frame, before.frame)), before.frame.normal
            _, same = reproject(own.before, frame.motion, here, there)
            same = same & ~approached(here[0], there[0], frame.motion)
            image = mixed(image, frame.radiance, before.image, frame.motion, same * own.before, own.after)
        return image

    def candidates(self, frame: Frame, forward: Estimate, backward: Estimate) -> Candidates:
        """What is known of a prepared frame."""
        single, opinion = (of(frame, forward, backward) for of in (self._single, self._opinion))
        return Candidates(forward.image, backward.image, single, opinion)

    def _opinion(self, frame: Frame, forward: Estimate, backward: Estimate) -> Tensor:
        """The filter's picture `[1, 3, H, W]`; the equation stands above. Albedo and normal are filtered beforehand."""
        seen, *counts = seen_on_both_sides(frame, forward, backward)
        radiance, albedo, normal = seen.split(FOOTPRINT, dim=1)
        seen = self._filter.prefiltered(replace(frame, radiance=radiance, albedo=albedo, normal=normal))
        light, surfaces = (as_seen(count - 1) for count in counts)
        if light.min() == surfaces.min() == 1:  # nothing is to be evened
            return self._filter.step(seen)[0]
        alone = self._filter.prefiltered(frame)
        alone = replace(alone, radiance=self._filter.step(alone)[0])
        shares = {"radiance": light, "albedo": surfaces, "normal": surfaces}
        even = {name: torch.lerp(getattr(alone, name), getattr(seen, name), share) for name, share in shares.items()}
        return self._filter.step(replace(frame, **even))[0]

    def _single(self, frame: Frame, forward: Estimate, backward: Estimate) -> Tensor:
        """The network's image of the frame alone; a pass that begins here has it already."""
        for estimate in (forward, backward):
            if estimate.first:
                return estimate.image
        return self.backend.denoise(frame, None)[0]


def as_seen(others: Tensor) -> Tensor:
    """The share a of what has been seen, from the number of frames beside this one, `[B, 1, H, W]` both; above."""
    return 1 - (1 - others).clamp(0, 1) * (box(others, AROUND) / EVENED_FROM).clamp(0, 1)


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
        frames = completed_shot(shot.frames)
        found, history = [], None
        for frame, forward in zip(reversed(frames), reversed(shot.estimates), strict=True):
            backward, history = self._passes.step(reverse(frame), history)
            found.insert(0, self._passes.combine(frame, forward, backward))
        sides = [None, *(Beside(frame, own.image) for frame, own in zip(frames, found, strict=True)), None]
        return [self._passes.settle(*of) for of in zip(frames, found, sides, sides[2:], strict=False)]


@dataclass(frozen=True)
class Shot:
    """The state of `InMemory`."""

    frames: list[Frame]  # prepared
    estimates: list[Estimate]  # of the forward pass
    history: Any  # of the forward pass
    images: list[Tensor] = field(default_factory=list)  # yet to be returned
