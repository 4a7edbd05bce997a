"""Samples that are lost. numpy only.

Where a path ends before it has met anything with a colour, as behind waves that are seen at a low angle, or within
glass, Cycles writes black albedo for a surface that was hit: a dot here and there, by chance. Networks take it for
texture, and leave the dots in the picture. What is seen is the mean of what all samples tell (docs/notes/lost.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..frame import Frame
from .around import EIGHT, around, shifted

MOST = 1  # of the eight pixels around a lost one that are black, too: more are a black surface
REACH = 2  # pixels over which albedo is averaged, along either axis
SAME_DEPTH = 0.1  # relative
CHUNK = 1 << 16  # pixels that are looked at together
FEW = 1 / 32  # share of the pixels up to which they are looked at one by one


def with_lost_samples(
    frame: Frame,  # numpy arrays of one picture
) -> Frame:
    """The frame with the mean of albedo over the 5×5 pixels around that show the same surface, where a sample was lost
    and in the eight pixels around. The frame itself where none was."""
    if (lost := lost_samples(frame)) is None:
        return frame
    near = np.logical_or.reduce([lost, *shifted(lost, EIGHT, 1)]) & (frame.depth[0, 0] > 0)
    return with_mean_albedo(frame, near)


@np.errstate(invalid="ignore")  # broken pixels are compared, and count for nothing
def with_mean_albedo(frame: Frame, near: np.ndarray) -> Frame:
    """The frame with the mean of albedo over the 5×5 pixels around that show the same surface, in the pixels that are
    `near`, `[H, W]` bool."""
    albedo, depth = frame.albedo[0], frame.depth[0, 0]
    mean = _everywhere(albedo, depth) if near.mean() > FEW else _at_places(albedo, depth, near)
    found = np.where(near & np.isfinite(mean).all(0), mean, albedo).astype(albedo.dtype)
    return replace(frame, albedo=found[None])


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
    if not black.any():
        return None
    return black & (sum(beside.astype(np.int8) for beside in shifted(black, EIGHT, 1)) <= MOST)
