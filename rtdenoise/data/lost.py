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
    albedo, depth = np.moveaxis(frame.albedo[0], 0, 2), frame.depth[0, 0]
    found, rows, columns = albedo.copy(), *np.nonzero(near)
    for start in range(0, len(rows), CHUNK):
        place = rows[start : start + CHUNK], columns[start : start + CHUNK]
        there, colours, own = around(depth, place, REACH), around(albedo, place, REACH), depth[place][:, None]
        same = (np.abs(there - own) <= SAME_DEPTH * np.maximum(there, own)) & np.isfinite(colours).all(2)
        mean = (colours * same[..., None]).sum(1, where=same[..., None]) / np.maximum(same.sum(1), 1)[:, None]
        found[place] = np.where(same.any(1)[:, None], mean, albedo[place])
    return replace(frame, albedo=np.ascontiguousarray(np.moveaxis(found, 2, 0))[None])


def lost_samples(frame: Frame) -> np.ndarray | None:
    """The pixels of a frame whose sample was lost, `[H, W]` bool; None where there are no black surfaces at all."""
    if len(frame.radiance) != 1 or frame.albedo is None or frame.depth is None:
        return None
    black = (frame.albedo[0] == 0).all(0) & (frame.depth[0, 0] > 0)
    if not black.any():
        return None
    return black & (sum(beside.astype(np.int8) for beside in shifted(black, EIGHT, 1)) <= MOST)
