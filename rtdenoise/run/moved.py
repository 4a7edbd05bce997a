"""The mean light of a frame and of its neighbours in time, moved to it along tested motion.

Every lookup takes the nearest pixel. Bilinear lookups mix the noise of four pixels; what they leave is blotches, which
OIDN takes for light (docs/notes/offline.md). Motion is chained from frame to frame, so lookups do not drift.

Where light has changed a frame is left out. Two tests find it: over a neighbourhood its light differs from this
frame's by more than noise (`alike`), or denoised pictures of both frames show the same differences as the noisy ones
(`explained`). The first sees lamps and shadows, the second reflections and refractions, which move in another way than
their surface does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..color import albedo_divisor
from ..frame import Frame
from ..models.window import box, two_step
from ..ops import reproject
from ..ops.pixels import demodulate

REACH = 4  # frames before, and as many after
SIDE = 13  # pixels, odd: of the neighbourhood in which light is compared
ALIKE, CHANGED = 2.0, 6.0  # (mean difference / its standard error)²: of light that counts whole, and not at all
SIDE_EXPLAINED = 7  # pixels, odd: of the neighbourhood in which pictures are compared
NOISE, LIGHT = 0.1, 0.2  # explained share of a difference: of light that counts whole, and not at all


@dataclass(frozen=True)
class Seen:
    """A frame of a shot, and OIDN's picture of it, where OIDN is installed."""

    frame: Frame
    clean: Frame | None = None  # with filtered albedo and normal
    picture: Tensor | None = None  # [B, 3, H, W] linear radiance


def moved_mean(
    now: Seen,
    before: Sequence[Seen],  # of the same shot, the nearest first
    after: Sequence[Seen],  # likewise; their `motion_next` leads away from `now`, as their `motion` does before it
) -> Tensor:
    """Radiance `[B, 3, H, W]`: light over albedo, averaged over all frames that show the pixel's surface in the same
    light, times the averaged albedo.

    Frames need valid features, and pictures. A direction ends where the next motion is missing.
    """
    frame = now.frame
    noisy, denoised = _lights(now)
    light, albedo, count = noisy, frame.albedo, torch.ones_like(frame.depth)
    for layer, neighbours in (("motion", before), ("motion_next", after)):
        motion, last = None, frame
        for seen in neighbours:
            there, onward = seen.frame, getattr(last, layer)
            if onward is None:
                break
            motion = onward if motion is None else two_step(motion, onward)
            surfaces = (frame.depth, frame.normal), (there.depth, there.normal)
            whole = motion.round()  # pixels: the nearest one alone
            its_noisy, its_denoised = _lights(seen)
            found, valid = reproject((its_noisy, there.albedo), whole, *surfaces)
            its_light, its_albedo = found.split(3, dim=1)
            difference, valid = its_light - noisy, valid.to(noisy.dtype)
            of_pictures = reproject(its_denoised, whole, *surfaces)[0] - denoised
            share = valid * alike(difference, valid) * unexplained(difference, of_pictures, valid)
            light, albedo, count = light + share * its_light, albedo + share * its_albedo, count + share
            last = there
    return light / count * albedo_divisor(albedo / count, frame.depth)


def alike(
    difference: Tensor,  # [B, 3, H, W] of a neighbour's light from this frame's
    valid: Tensor,  # [B, 1, H, W] in {0, 1}
) -> Tensor:  # [B, 1, H, W] in [0, 1]
    """1 where the mean difference over `SIDE` × `SIDE` pixels is within its noise, 0 where light has changed.

    q = |mean d|² n / mean |d|²        over the n valid pixels: 1 on average if d is noise alone
    """
    share = box(valid, SIDE).clamp(min=1e-6)
    mean, square = (box(valid * x, SIDE) / share for x in (difference, difference.square()))
    q = SIDE**2 * share * mean.square().sum(1, keepdim=True) / square.sum(1, keepdim=True).clamp(min=1e-30)
    return ((CHANGED - q) / (CHANGED - ALIKE)).clamp(0, 1)


def unexplained(
    difference: Tensor,  # [B, 3, H, W] of a neighbour's light d
    of_pictures: Tensor,  # likewise of its denoised picture p
    valid: Tensor,  # [B, 1, H, W] in {0, 1}
) -> Tensor:  # [B, 1, H, W] in [0, 1]
    """1 where denoised pictures show little of the difference, 0 where they show a fifth of it: then it is light.

    r = Σ d p / Σ d²        over `SIDE_EXPLAINED` × `SIDE_EXPLAINED` pixels
    """
    together, square = (
        box((valid * difference * x).sum(1, keepdim=True), SIDE_EXPLAINED) for x in (of_pictures, difference)
    )
    return ((LIGHT - together / square.clamp(min=1e-30)) / (LIGHT - NOISE)).clamp(0, 1)


def _lights(seen: Seen) -> tuple[Tensor, Tensor]:
    """Noisy and denoised light over albedo, `[B, 3, H, W]` each."""
    frame = seen.frame
    return tuple(demodulate(x, frame.albedo, frame.depth) for x in (frame.radiance, seen.picture))
