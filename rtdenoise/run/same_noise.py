"""Frames with the same noise: a renderer whose seed stands still, as Cycles' does by itself. numpy only."""

from __future__ import annotations

import numpy as np

from ..frame import Frame
from ..sanitise import FAR

MOST = 512  # pixels along either side, in the middle of the picture, that are looked at
MOVES = 0.5  # pixels along an axis: from this motion on another surface was in the same place before
LEAST = 500  # pixels that tell
ROUGH = 0.2  # least difference from the pixel beside, as a share of the greater one, where there is noise
ALIKE = 0.5  # correlation of noise, or share of rough pixels that are the same to the bit: else 0 to 0.1
SAME_NOISE = (
    "the noise is the same in {}, so that history cannot average it: render every frame with a seed of its own (in "
    "Cycles the clock beside Seed)"
)


def has_same_noise(before: Frame, now: Frame) -> bool:
    """Whether a frame (numpy arrays) has the noise of the one before it, in the same pixels.

    Where surfaces move, what a pixel has more than those around it is compared with the same place before, and with the
    same surface, to which textures belong. Where all stands still, light is the same to the bit.
    """
    y, x = (slice(max(0, (n - MOST) // 2), (n + MOST) // 2) for n in now.size)
    a, b = (_root(frame.radiance[0, :, y, x]) for frame in (before, now))
    if b.shape != a.shape or min(b.shape) < 3:
        return False
    depth = np.ones_like(b) if now.depth is None else now.depth[0, 0, y, x]
    motion = np.zeros((2, *b.shape)) if now.motion is None else np.nan_to_num(now.motion[0, :, y, x])
    inner = slice(1, -1), slice(1, -1)
    hit, moved = np.isfinite(depth) & (depth > 0), np.abs(motion).max(0) > MOVES
    moves, stands = (hit & moved)[inner], (hit & ~moved)[inner]
    if moves.sum() >= max(LEAST, stands.sum()):
        then, here = _above(a), _above(b)
        place = _correlation(then[moves], here[moves])
        return place > ALIKE and place > _along(then, here, motion[:, 1:-1, 1:-1], moves)
    rough = stands & (np.abs(b[inner] - b[1:-1, 2:]) > ROUGH * np.maximum(b[inner], b[1:-1, 2:]))
    return rough.sum() >= LEAST and float((a == b)[inner][rough].mean()) > ALIKE


def _along(then: np.ndarray, here: np.ndarray, motion: np.ndarray, moves: np.ndarray) -> float:
    """Correlation with the places that motion leads to, between pixels."""
    row, column = np.nonzero(moves)
    y, x = row + motion[1, row, column], column + motion[0, row, column]
    inside = (y >= 0) & (y < then.shape[0] - 1) & (x >= 0) & (x < then.shape[1] - 1)
    (top, v), (left, u) = ((place.astype(int), place % 1) for place in (y[inside], x[inside]))
    above, below = ((1 - u) * then[line, left] + u * then[line, left + 1] for line in (top, top + 1))
    return _correlation((1 - v) * above + v * below, here[row[inside], column[inside]])


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Of values whose means are 0; 0 where there is nothing."""
    sizes = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum()) / sizes if sizes > 0 else 0.0


def _root(radiance: np.ndarray) -> np.ndarray:
    """The root of light `[3, H, W]`, `[H, W]`: bright samples are not all that counts."""
    return np.sqrt(np.nan_to_num(radiance, nan=0.0, posinf=0.0, neginf=0.0).clip(0, FAR).mean(0, dtype=np.float64))


def _above(image: np.ndarray) -> np.ndarray:
    """What each inner pixel has more than the four beside it."""
    return image[1:-1, 1:-1] - (image[:-2, 1:-1] + image[2:, 1:-1] + image[1:-1, :-2] + image[1:-1, 2:]) / 4
