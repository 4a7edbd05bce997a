"""The combiner that needs no training: it corrects z as far as independent noisy estimates agree that z is wrong.

The noisy frames y and the estimate z differ by r = (y - z) / d, the error of z and noise; d is about z itself
(`window.divisor_of`). Two residuals a and b of the same surface with independent noise tell them apart:

    E = mean a b            estimates the squared error of z
    V = mean (a - b)² / 4   estimates the variance of their mean
    image = z + d w (a + b) / 2,    w = E' / (E' + V),    E' = max(E - t V, 0)

with means over a neighbourhood and the channels. With t = 0 this w has the least squared error if the noises of y and z
are uncorrelated (James and Stein 1961) and E is known. E is an estimate as noisy as V is large, and z was made from y,
so E must exceed a share t of V before it counts.

There are two sources of such pairs, and `Shrinkage.combine` uses both, one after the other: two halves of the samples
of a frame, where they are known; then the frame and the mean of its neighbours in time, along tested motion. In real
time `correct` takes a running mean of the frames before in place of the neighbours. Halves show the same pixels, so
d = 1 there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from ..exposure import exposure
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..ops import reproject
from ..ops.scattered import scattered
from ..sanitise import sanitise
from .window import Combined, Window, aligned, box, changed, comparable, current_of, divisor_of, with_features

Step = Callable[..., tuple[Tensor, History]]

SIDE = 9  # of the neighbourhood in pixels, odd
LEAST_USABLE = 0.25  # share of the neighbourhood that must tell
SMOOTH = 5  # side of the neighbourhood over which the weights w are averaged
# t: with these no case of data/combiner-held got worse than 1.02 times z's error (bench/combine.py).
SHARE_OF_HALVES = 5.0  # for two halves
SHARE_OF_FRAMES = 1.5  # for a frame and its neighbours
FEW_SAMPLES = 4  # below, an edge pixel's noisy light is that of one surface
MAX_DEPTH_STEP, MIN_AGREEMENT = 0.1, 0.95  # of an edge: relative range of depth, length of the mean normal
MAX_LENGTH = 8  # frames in a running mean of residuals: z changes, and resampling blurs
ROUNDING = 1e-4  # of a number of frames that was interpolated: whole ones stay so


@dataclass(frozen=True)
class Shrinkage:
    """Corrects the middle frame of windows of five (`combine`)."""

    offsets: tuple[int, ...] = (-2, -1, 0, 1, 2)
    """Frame numbers of the window relative to the corrected frame."""

    def combine(self, window: Window) -> Combined:
        """Correct one frame. Without `window.halves` and without neighbours, z is returned as it is.

        Where motion or features are missing, `aligned` says which neighbours are left. Raises ValueError where the
        window has another length or no current frame.
        """
        place = self.offsets.index(0)
        frame, before = current_of(window, place, len(self.offsets))
        window = corrected_by_halves(window)
        known = comparable(frame.radiance, window.estimates[place])[1]
        estimate = window.estimates[place].where(window.estimates[place].isfinite(), known)
        image = torch.maximum(estimate + by_neighbours(window, place), estimate.clamp(max=0))
        return Combined(image, changed(image, before))


def corrected_by_halves(window: Window) -> Window:
    """The window with every z corrected by `by_halves`, where it has halves."""
    if not window.halves:
        return window
    parts = zip(window.frames, window.estimates, window.halves, strict=True)
    return replace(window, estimates=tuple(by_halves(*part) for part in parts))


def by_halves(frame: Frame | None, estimate: Tensor | None, half: Tensor | None) -> Tensor | None:
    """z of a frame, corrected by two halves of its samples; None without a frame."""
    if frame is None or half is None:
        return estimate
    noisy, z = comparable(frame.radiance, estimate)
    a, b = (comparable(x, z)[0] - z for x in (half, 2 * frame.radiance - half))
    error, variance = (box(x.mean(1, keepdim=True), SIDE) for x in (a * b, (a - b).square() / 4))
    return (estimate + weight(error, variance, SHARE_OF_HALVES) * (noisy - z)).clamp(min=0)


def by_neighbours(window: Window, place: int) -> Tensor:
    """The correction that the neighbours of the frame at `place` support, `[B, 3, H, W]`."""
    frame, (found, _) = with_features(window.frames[place]), aligned(window, place)
    others = [one for k, one in enumerate(found) if one is not None and k != place]
    if not others:
        return torch.zeros_like(frame.radiance)
    count = sum(one.valid for one in others)
    mean = sum(one.residual for one in others) / count.clamp(min=1)
    return found[place].divisor * supported(frame, found[place].residual, mean, count)


def correct(
    frame: Frame,  # sanitised
    estimate: Tensor,  # [B, 3, H, W] z of the frame, finite
    history: History | None,  # of the frame before
    onward: History,  # of this frame, from the denoiser
) -> tuple[Tensor, History]:
    """The recurrent form, without a look ahead: instead of the neighbours the running mean of the residuals of the
    frames before, along tested motion. Returns the corrected image, and `onward` with the mean that goes on.
    """
    divisor = divisor_of(estimate.clamp(min=0), exposure(estimate))
    own = (frame.radiance - estimate) / divisor
    mean, count = torch.zeros_like(own), torch.zeros_like(own[:, :1])
    if history is not None and history.residual is not None:
        surfaces = (frame.depth, frame.normal), (history.depth, history.normal)
        found, valid = reproject((history.residual, history.residual_length), frame.motion, *surfaces)
        mean, count = found[:, :3], (found[:, 3:] * valid + ROUNDING).floor()
    image = torch.maximum(estimate + divisor * supported(frame, own, mean, count), estimate.clamp(max=0))
    mean = (own + count * mean) / (count + 1)
    return image, replace(onward, residual=mean, residual_length=(count + 1).clamp(max=MAX_LENGTH))


def corrected(step: Step) -> Step:
    """A denoiser's step, followed by `correct`. Its images are corrected, its own history is not."""

    def corrected_step(frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN):
        frame, known = frame if known.sanitised else sanitise(frame), replace(known, sanitised=True)
        before = history and replace(history, residual=None, residual_length=None)
        estimate, onward = step(frame, before, known)
        return correct(frame, estimate, history, onward)

    return corrected_step


def supported(
    frame: Frame,  # valid features
    own: Tensor,  # [B, 3, H, W] relative residual of the frame
    mean: Tensor,  # [B, 3, H, W] mean of those of other frames, aligned to it
    count: Tensor,  # [B, 1, H, W] number of these
) -> Tensor:  # [B, 3, H, W]
    """w (a + b) / 2 for a = `own` and b = `mean`, weighted as a mean of all frames; relative, too."""
    usable = count > 0
    if (few := few_samples(frame)).any():
        usable &= ~(edges(frame) & few)
    return agreement(own, mean, count, usable.to(own.dtype)) * (own + count * mean) / (count + 1)


def agreement(
    own: Tensor,  # [B, 3, H, W] relative residual of the frame
    mean: Tensor,  # [B, 3, H, W] mean of those of other frames
    count: Tensor,  # [B, 1, H, W] number of these
    usable: Tensor,  # [B, 1, H, W] in {0, 1}
) -> Tensor:  # [B, 1, H, W] in [0, 1], 0 where not usable
    """w of a = `own` and b = `mean`, weighted as a mean of all frames."""
    tells, known = usable, box(usable, SIDE)
    usable = usable * (known >= LEAST_USABLE)
    known = known.clamp(min=1e-6)
    # a - b has (count + 1) / count of a frame's variance, the mean of all frames 1 / (count + 1) of it
    error, variance = (
        box(tells * x.mean(1, keepdim=True), SIDE) / known
        for x in (own * mean, (own - mean).square() * count / (count + 1).square())
    )
    return weight(error, variance, SHARE_OF_FRAMES) * usable


def weight(error: Tensor, variance: Tensor, share: float) -> Tensor:
    """w of E and V, smoothed; both `[B, 1, H, W]`."""
    error = (error - share * variance).clamp(min=0)
    return box(error / (error + variance).clamp(min=1e-30), SMOOTH)


def few_samples(frame: Frame) -> Tensor:
    """Whether a frame has few samples a pixel, or an unknown number: bool, `[B, 1, H, W]` or `[1]`."""
    if frame.samples is None:
        return torch.ones(1, dtype=torch.bool, device=frame.radiance.device)
    return ~(frame.samples >= FEW_SAMPLES)  # True for NaN too


def edges(frame: Frame) -> Tensor:  # [B, 1, H, W] bool
    """Pixels next to another surface, or to one that is hit here and there (`scattered`), of a frame with valid
    features. A single sample of such a pixel shows one of them, and the neighbour frames that pass the test show the
    same one: their residuals agree although z is right."""
    far, near = (_extreme(frame.depth, which) for which in (torch.maximum, torch.minimum))
    length = _squares(frame.normal)
    agreement = _squares(box(frame.normal * length.clamp(min=1e-12).rsqrt(), 3))
    beside = (far - near > MAX_DEPTH_STEP * near.clamp(min=1e-6)) | ((agreement < MIN_AGREEMENT**2) & (length > 0))
    least, greatest = scattered(frame.depth).split(1, dim=1)
    return beside | (least <= greatest)


def _extreme(image: Tensor, which: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """The greatest or least of 3×3 pixels; faster on the CPU than `max_pool2d`."""
    image = F.pad(image, (1, 1, 1, 1), mode="replicate")
    rows = which(which(image[:, :, :-2], image[:, :, 1:-1]), image[:, :, 2:])
    return which(which(rows[..., :-2], rows[..., 1:-1]), rows[..., 2:])


def _squares(vectors: Tensor) -> Tensor:
    """Squared lengths; `torch.norm` over channels is many times slower on the CPU."""
    return vectors[:, :1].square() + vectors[:, 1:2].square() + vectors[:, 2:].square()
