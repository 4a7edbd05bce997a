"""Samples whose path ended at a mirror. numpy only.

Where a surface mirrors, Cycles writes the albedo of what is seen in it. But a sample of such a surface may end there,
as in a glossy floor: it has what the surface has of its own, nearly black. These are dark dots by chance, which
networks take for texture, and leave in the picture. What is seen there is what the samples around tell
(docs/notes/mirrors.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..frame import Frame
from .around import beside_each, groups
from .virtual_depth import Seen

DARK = 0.5  # times the albedo that is seen around: a dot is darker
MOST = 6  # dark pixels that touch: more are a line, a texture or an object
LEAST = 4  # of the eight pixels around, that must show what is seen in the same surface
SAME_DEPTH = 0.1  # relative


@np.errstate(all="ignore")  # broken pixels are compared, and count for nothing
def with_seen_albedo(
    frame: Frame,  # numpy arrays of one picture, with albedo
    seen: Seen,
) -> Frame:
    """The frame with the median albedo of the pixels around that show what is seen in the same surface, in dark dots
    between them whose path ended. Black ones are left to `lost`. The frame itself where there are no dots."""
    through = np.pad(seen.through, 1)
    rows = through[:-2] | through[1:-1] | through[2:]
    near = seen.ended & (rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:])
    if not near.any():
        return frame
    # Indices of pixels in pictures with a border, where nothing is seen.
    place = np.flatnonzero(np.pad(near, 1))
    light, depth = np.pad(frame.albedo[0].sum(0), 1), np.pad(seen.depth, 1)
    beside = beside_each(place, through)
    there = np.where(through.take(beside), light.take(beside), np.float32(0))
    own = light.take(place)
    maybe = (own > 0) & (own < DARK * np.fmax.reduce(there))
    place, own, there = place[maybe], own[maybe], there[:, maybe]
    beside, its_depth = beside_each(place, through), depth.take(place)
    same = (there > 0) & np.isfinite(there) & (np.abs(depth.take(beside) - its_depth) < SAME_DEPTH * its_depth)
    dark = own < DARK * _median(there, same)
    place, same = place[dark], same[:, dark]
    dots = (same.sum(0) >= LEAST) & (_size(groups(place, through)) <= MOST)
    if not dots.any():
        return frame
    place, same, albedo = place[dots], same[:, dots], np.pad(frame.albedo[0], [(0, 0), (1, 1), (1, 1)])
    for plane in albedo.reshape(len(albedo), -1):
        plane[place] = _median(plane.take(beside_each(place, through)), same)
    return replace(frame, albedo=np.ascontiguousarray(albedo[None, :, 1:-1, 1:-1]))


def _median(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The median `[N]` of those of values `[8, N]` that count; NaN where none does."""
    ordered = np.sort(np.where(counts, values, np.float32(np.nan)).T, axis=1)  # NaN comes last
    number, each = counts.sum(0), np.arange(len(ordered))
    return (ordered[each, (number - 1).clip(0) // 2] + ordered[each, number // 2 % 8]) / 2


def _size(label: np.ndarray) -> np.ndarray:
    """How many places have the label of each, `[N]`."""
    return np.bincount(label, minlength=len(label))[label]
