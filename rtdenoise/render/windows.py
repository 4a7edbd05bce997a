"""Windows for training clips: parts of a picture and of time with activity, found from first hits alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .frames import features, uncovered
from .stage import Stage

COARSE = 4  # pixels of the picture to a pixel of the survey, in each direction
MOTION_WEIGHT = 0.002  # share of uncovered pixels that counts as much as a motion of one pixel a frame,
MAX_MOTION = 10  # up to this many pixels a frame
MAX_OVERLAP = 0.5  # share of pixels and frames that two windows of a scene may have in common


@dataclass(frozen=True)
class ClipWindow:
    """A rectangle of a picture, from one frame on."""

    first: int  # first frame
    top: int  # in pixels of the whole picture
    left: int
    uncovered: float  # share of pixels that were hidden one frame before, mean over the frames
    motion: float  # mean length in pixels a frame


@dataclass(frozen=True)
class Survey:
    """Activity in a picture over T frames, one pixel for COARSE × COARSE. In the first frame nothing is uncovered."""

    uncovered: np.ndarray  # [T, h, w] bool
    motion: np.ndarray  # [T, h, w] pixels of the whole picture a frame; 0 for surfaces that were off the screen
    sky: float  # share of pixels without a hit
    near: float  # distance of the nearest twentieth


def survey(stage: Stage, frames: int, view: tuple[int, int]) -> Survey:
    """Survey frames 0 … frames − 1 of a picture of `view` = (height, width)."""
    size = (view[0] // COARSE, view[1] // COARSE)
    seen = [features(stage, n, size) for n in range(frames)]
    hidden = [np.zeros(size, bool)]
    hidden += [uncovered(b["motion"], a["motion_next"]) for a, b in pairwise(seen)]
    length = np.stack([np.linalg.norm(f["motion"], axis=-1) for f in seen]) * COARSE
    depth = np.concatenate([f["depth"].ravel() for f in seen])
    hit = depth > 0
    return Survey(
        np.stack(hidden),
        np.where(length < view[1], length, 0),
        float((~hit).mean()),
        float(np.quantile(depth[hit], 0.05)) if hit.any() else 0.0,
    )


def candidates(found: Survey, size: tuple[int, int], frames: int) -> list[ClipWindow]:
    """All windows of `size` = (height, width) and `frames` frames, in steps of an eighth of the window and of half its
    frames."""
    h, w = size[0] // COARSE, size[1] // COARSE
    steps = max(h // 8, 1), max(w // 8, 1)
    windows = []
    for first in range(0, len(found.motion) - frames + 1, max(frames // 2, 1)):
        hidden = _means(found.uncovered[first + 1 : first + frames], h, w, steps)
        motion = _means(found.motion[first : first + frames], h, w, steps)
        for (i, j), moved in np.ndenumerate(motion):
            top, left = i * steps[0] * COARSE, j * steps[1] * COARSE
            windows.append(ClipWindow(first, top, left, float(hidden[i, j]), float(moved)))
    return windows


def _means(values: np.ndarray, h: int, w: int, steps: tuple[int, int]) -> np.ndarray:
    """The mean of `values` [T, H, W] over each window of h × w pixels and all T, in steps; 0 where T is 0."""
    sums = values.sum(0, dtype=np.float64).cumsum(0).cumsum(1)
    sums = np.pad(sums, ((1, 0), (1, 0)))
    sums = sums[h:, w:] - sums[:-h, w:] - sums[h:, :-w] + sums[:-h, :-w]
    return sums[:: steps[0], :: steps[1]] / (max(len(values), 1) * h * w)


def mean(values: np.ndarray) -> float:
    """Their mean, 0 for none: a single frame uncovers nothing."""
    return float(values.mean()) if values.size else 0.0


def choose(windows: list[ClipWindow], taken: list[ClipWindow], size, frames: int, active: bool, rng) -> ClipWindow:
    """The window with the most activity, or (not `active`) a random one. Windows that overlap one of those `taken` by
    MAX_OVERLAP come last. Activity is the share of uncovered pixels, and a little for motion."""
    fresh = [w for w in windows if all(_overlap(w, t, size, frames) < MAX_OVERLAP for t in taken)] or windows
    if not active:
        return fresh[rng.integers(len(fresh))]
    return max(fresh, key=lambda w: w.uncovered + MOTION_WEIGHT * min(w.motion, MAX_MOTION))


def _overlap(a: ClipWindow, b: ClipWindow, size, frames: int) -> float:
    share = 1.0
    for p, q, length in ((a.first, b.first, frames), (a.top, b.top, size[0]), (a.left, b.left, size[1])):
        share *= max(0.0, 1 - abs(p - q) / length)
    return share


def look_through(stage: Stage, window: ClipWindow, view: tuple[int, int]) -> Stage:
    """Narrow the stage's camera to a window of the picture that it shows now."""
    stage.scene = stage.scene.seen_through((*view, window.top, window.left))
    return stage
