"""Samples that are lost. numpy only.

Where a path ends before it has met anything with a colour, as behind waves that are seen at a low angle, within glass,
or between mirrors, Cycles writes black albedo for a surface that was hit: dots by chance. Networks take them for
texture, and leave them in the picture. What is seen is what the other samples around tell (docs/notes/lost.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..frame import Frame
from .around import EIGHT, around, beside_each, groups, shifted

MOST = 20  # black pixels that hang together: more are a black surface, or a line
LEAST_SINGLE = 1 / 3  # of the groups of so many that are one pixel, as dots by chance are; else
FEW_TOGETHER = 2  # are the most
ALIKE = 0.3  # relative: how near the mean a sample beside a lost one is that stays
REACH = 2  # pixels over which albedo is averaged, along either axis
SAME_DEPTH = 0.1  # relative
CHUNK = 1 << 16  # pixels that are looked at together
FEW = 1 / 32  # share of the pixels up to which they are looked at one by one


def with_lost_samples(
    frame: Frame,  # numpy arrays of one picture
) -> Frame:
    """The frame with the mean of albedo over the 5×5 pixels around that show the same surface, without lost ones, where
    a sample was lost, and in those of the eight pixels around that are unlike it: what they saw was chance, too. The
    frame itself where none was."""
    lost = lost_samples(frame)
    if lost is None or not lost.any():
        return frame
    near = np.logical_or.reduce([lost, *shifted(lost, EIGHT, 1)]) & (frame.depth[0, 0] > 0)
    return with_mean_albedo(frame, near, lost)


@np.errstate(invalid="ignore")  # broken pixels are compared, and count for nothing
def with_mean_albedo(frame: Frame, near: np.ndarray, lost: np.ndarray | None = None) -> Frame:
    """The frame with the mean of albedo over the 5×5 pixels around that show the same surface, in the pixels that are
    `near`, `[H, W]` bool. Where some are `lost` they are not in the mean, and others that are `ALIKE` stay."""
    albedo, depth = frame.albedo[0], frame.depth[0, 0]
    counted = albedo if lost is None else np.where(lost, np.float32(np.nan), albedo)
    mean = _everywhere(counted, depth) if near.mean() > FEW else _at_places(counted, depth, near)
    changes = near & np.isfinite(mean).all(0)
    if lost is not None:
        changes &= lost | (np.abs(albedo - mean) > ALIKE * mean).any(0)
    return replace(frame, albedo=np.where(changes, mean, albedo).astype(albedo.dtype)[None])


def _at_places(albedo: np.ndarray, depth: np.ndarray, near: np.ndarray) -> np.ndarray:
    """The means `[3, H, W]` in the pixels that are `near`; NaN where none shows the surface, and in all others."""
    image, rows, columns = np.moveaxis(albedo, 0, 2), *np.nonzero(near)
    mean = np.full(image.shape, np.nan)
    for start in range(0, len(rows), CHUNK):
        place = rows[start : start + CHUNK], columns[start : start + CHUNK]
        there, colours, own = around(depth, place, REACH), around(image, place, REACH), depth[place][:, None]
        same = _same(there, own) & np.isfinite(colours).all(2)
        mean[place] = colours.sum(1, where=same[..., None]) / np.where(same.any(1), same.sum(1), np.nan)[:, None]
    return np.moveaxis(mean, 2, 0)


def _everywhere(albedo: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """The means in all pixels, which takes less time where many are wanted."""
    finite = np.isfinite(albedo).all(0)
    layers = np.concatenate([np.where(finite, albedo, 0), np.where(finite, depth, np.nan)[None]])
    total, count = np.zeros(albedo.shape), np.zeros(depth.shape)
    reach = range(-REACH, REACH + 1)
    for beside in shifted(layers, [(y, x) for y in reach for x in reach], REACH):
        same = _same(beside[3], depth)
        total += beside[:3] * same
        count += same
    return total / np.where(count > 0, count, np.nan)


def _same(there: np.ndarray, own: np.ndarray) -> np.ndarray:
    return np.abs(there - own) <= SAME_DEPTH * np.maximum(there, own)


def lost_samples(frame: Frame) -> np.ndarray | None:
    """The pixels of a frame whose sample was lost, `[H, W]` bool; None where there are no black surfaces at all."""
    if len(frame.radiance) != 1 or frame.albedo is None or frame.depth is None:
        return None
    black = (frame.albedo[0] == 0).all(0) & (frame.depth[0, 0] > 0)
    return _small_groups(black) if black.any() else None


def _small_groups(black: np.ndarray) -> np.ndarray:
    """The black pixels `[H, W]` in groups that are small (MOST, LEAST_SINGLE), and hang together with no 3×3 black ones
    at all."""
    edged = np.pad(black, 2)
    rows = edged[:-2] & edged[1:-1] & edged[2:]
    solid = np.pad(rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:], 1)
    solid = np.logical_or.reduce([solid, *shifted(solid, EIGHT, 1)])
    place = np.flatnonzero(edged & ~solid)
    label = groups(place, edged)
    size = np.bincount(label, minlength=len(place))
    size[label[solid.take(beside_each(place, edged)).any(0)]] = MOST + 1
    single, small = np.count_nonzero(size == 1), np.count_nonzero((size > 0) & (size <= MOST))
    most = MOST if single >= LEAST_SINGLE * small else FEW_TOGETHER
    lost = np.zeros(edged.shape, bool)
    lost.flat[place[size[label] <= most]] = True
    return lost[2:-2, 2:-2]
