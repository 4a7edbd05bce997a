"""The combiner that needs no training: it corrects z as far as independent noisy estimates agree that z is wrong.

The noisy frames y and the estimate z differ by r = y - z, the error of z and noise. Two residuals a and b of the same
surface with independent noise tell them apart:

    E = mean a b            estimates the squared error of z
    V = mean (a - b)² / 4   estimates the variance of their mean
    image = z + w (a + b) / 2,    w = E' / (E' + V),    E' = max(E - t V, 0)

with means over a neighbourhood and the channels. With t = 0 this w has the least squared error if the noises of y and z
are uncorrelated (James and Stein 1961) and E is known. E is an estimate as noisy as V is large, and z was made from y,
so E must exceed a share t of V before it counts.

There are two sources of such pairs, and `Shrinkage.combine` uses both, one after the other: two halves of the samples
of a frame, where they are known; then the frame and the mean of its neighbours in time, along tested motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import albedo_divisor
from ..frame import Frame
from .window import Combined, Window, aligned, box, comparable, completed, current_of

FEW_SAMPLES = 4  # below, an edge pixel's noisy light is that of one surface
MAX_DEPTH_STEP, MIN_AGREEMENT = 0.1, 0.95  # of an edge: relative range of depth, length of the mean normal


@dataclass(frozen=True)
class Shrinkage:
    """Corrects the middle frame of windows of five frames; with `causal` the last one of three."""

    causal: bool = False
    side: int = 9  # of the neighbourhood in pixels, odd
    smooth: int = 5  # side of the neighbourhood over which the weights w are averaged
    share_of_halves: float = 2.0  # t for two halves,
    share_of_frames: float = 1.5  # and for a frame and its neighbours

    @property
    def offsets(self) -> tuple[int, ...]:
        """Frame numbers of the window relative to the corrected frame."""
        return tuple(range(-2, 1 if self.causal else 3))

    def combine(self, window: Window) -> Combined:
        """Correct one frame. Without `window.halves` and without neighbours, z is returned as it is.

        Where motion or features are missing, `aligned` says which neighbours are left. Raises ValueError where the
        window has another length or no current frame.
        """
        place = self.offsets.index(0)
        frame, before = current_of(window, place, len(self.offsets))
        if window.halves:
            parts = zip(window.frames, window.estimates, window.halves, strict=True)
            window = replace(window, estimates=tuple(self._by_halves(*part) for part in parts))
        known = comparable(frame.radiance, window.estimates[place])[1]
        estimate = window.estimates[place].where(window.estimates[place].isfinite(), known)
        image = torch.maximum(estimate + self._by_neighbours(window, place), estimate.clamp(max=0))
        return Combined(image, (image - before.where(before.isfinite(), image)).abs().mean(1, keepdim=True))

    def _by_halves(self, frame: Frame | None, estimate: Tensor | None, half: Tensor | None) -> Tensor | None:
        """z of a frame, corrected by two halves of its samples."""
        if frame is None or half is None:
            return estimate
        noisy, z = comparable(frame.radiance, estimate)
        a, b = (comparable(x, z)[0] - z for x in (half, 2 * frame.radiance - half))
        error, variance = (box(x.mean(1, keepdim=True), self.side) for x in (a * b, (a - b).square() / 4))
        return (estimate + self._weight(error, variance, self.share_of_halves) * (noisy - z)).clamp(min=0)

    def _by_neighbours(self, window: Window, place: int) -> Tensor:
        """w (a + b) / 2 for the residual a of the frame and the mean b of those of its neighbours, `[B, 3, H, W]`."""
        frame = completed(window.frames[place])
        found = aligned(window, place, demodulate=True)
        divisor = albedo_divisor(frame.albedo, frame.depth)
        own = found[place].residual * divisor
        others = [one for k, one in enumerate(found) if one is not None and k != place]
        if not others:
            return torch.zeros_like(own)
        count = sum(one.valid for one in others)
        mean = sum(one.residual for one in others) * divisor / count.clamp(min=1)
        usable = (count > 0) & ~(edges(frame) & few_samples(frame))
        usable = usable.to(own.dtype)
        share = box(usable, self.side).clamp(min=1e-6)
        # a - b has (count + 1) / count of a frame's variance, the mean of all frames 1 / (count + 1) of it
        error, variance = (
            box(usable * x.mean(1, keepdim=True), self.side) / share
            for x in (own * mean, (own - mean).square() * count / (count + 1).square())
        )
        weight = self._weight(error, variance, self.share_of_frames) * usable
        return weight * (own + count * mean) / (count + 1)

    def _weight(self, error: Tensor, variance: Tensor, share: float) -> Tensor:
        error = (error - share * variance).clamp(min=0)
        return box(error / (error + variance).clamp(min=1e-30), self.smooth)


def few_samples(frame: Frame) -> Tensor:
    """Whether a frame has few samples a pixel, or an unknown number: bool, `[B, 1, H, W]` or `[1]`."""
    if frame.samples is None:
        return torch.ones(1, dtype=torch.bool, device=frame.radiance.device)
    return frame.samples < FEW_SAMPLES


def edges(frame: Frame) -> Tensor:  # [B, 1, H, W] bool
    """Pixels next to another surface, of a frame with valid features. A single sample of such a pixel shows one of the
    two, and the neighbour frames that pass the test show the same one: their residuals agree although z is right."""
    far, near = F.max_pool2d(frame.depth, 3, 1, 1), -F.max_pool2d(-frame.depth, 3, 1, 1)
    normal = F.normalize(frame.normal, dim=1, eps=1e-6)
    bent = box(normal, 3).norm(dim=1, keepdim=True) < MIN_AGREEMENT
    known = frame.normal.abs().sum(1, keepdim=True) > 0
    return (far - near > MAX_DEPTH_STEP * near.clamp(min=1e-6)) | (bent & known)
