"""The mean light of a frame and of its neighbours in time, moved to it along tested motion.

Every lookup takes the nearest pixel. Bilinear lookups mix the noise of four pixels; what they leave is blotches, which
OIDN takes for light (docs/notes/offline.md). Motion is chained from frame to frame, so lookups do not drift. Where
light has changed a frame is left out: there its light differs from this frame's by more than noise, over a
neighbourhood.
"""

from __future__ import annotations

from collections.abc import Sequence

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


def moved_mean(
    frame: Frame,
    before: Sequence[Frame],  # of the same shot, the nearest first
    after: Sequence[Frame],  # likewise; their `motion_next` leads away from `frame`, as their `motion` does before it
) -> Tensor:
    """Radiance `[B, 3, H, W]`: light over albedo, averaged over all frames that show the pixel's surface in the same
    light, times the averaged albedo.

    Frames need valid features. A direction ends where the next motion is missing.
    """
    now = demodulate(frame.radiance, frame.albedo, frame.depth)
    light, albedo, count = now, frame.albedo, torch.ones_like(frame.depth)
    for layer, neighbours in (("motion", before), ("motion_next", after)):
        motion, last = None, frame
        for there in neighbours:
            onward = getattr(last, layer)
            if onward is None:
                break
            motion = onward if motion is None else two_step(motion, onward)
            stored = demodulate(there.radiance, there.albedo, there.depth), there.albedo
            surfaces = (frame.depth, frame.normal), (there.depth, there.normal)
            found, valid = reproject(stored, motion.round(), *surfaces)  # whole pixels: the nearest one alone
            its_light, its_albedo = found.split(3, dim=1)
            share = valid * alike(its_light - now, valid.to(now.dtype))
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
