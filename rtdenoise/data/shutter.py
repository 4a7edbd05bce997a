"""Motion blur: surfaces as a shutter sees them that is open for a while. numpy only.

Under motion blur every sample shows another moment, so that one sample's albedo and normal are noise wherever something
moves, and renderers write no motion. A second render without blur tells where every surface is, and how it moves:
where that takes it while the shutter is open, its albedo and normal count in each pixel as long as they are seen there
(docs/notes/motion_blur.md).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..frame import OFF_SCREEN, Frame

if TYPE_CHECKING:
    from .sequences import Sequence

LEAST, MOST = 16, 64  # moments at which a picture that moves is looked at: as many as the longest way has pixels
FEW = 0.1  # of the pixels: so many may pass the seam of a panorama
SAME = 0.95  # part of a depth that is as far away
BLURRED, GIVEN = ("albedo", "normal"), ("albedo", "normal", "depth", "motion", "motion_next")


@dataclass(frozen=True)
class Surfaces:
    """A render of the same frames without motion blur, and for how long the shutter is open."""

    sequence: Sequence
    opens: float = -0.25  # frames, from the time of the frame
    closes: float = 0.25
    layers: tuple[str, ...] = GIVEN

    def give(self, frame: Frame) -> Frame:
        """A frame of the render with motion blur (numpy arrays), with the layers of this one: albedo and normal as the
        shutter sees them, and its own where this one has none."""
        if not self.layers:
            return frame
        sharp = self.sequence.read(self.index(frame.number))
        found = {layer: getattr(sharp, layer) for layer in self.layers}
        blurred = {layer: found.pop(layer) for layer in BLURRED if layer in found}
        found |= self.seen(sharp, {layer: x for layer, x in blurred.items() if x is not None})
        return replace(frame, **found)

    def seen(self, sharp: Frame, images: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Images `[1, C, H, W]` of a frame of this render, as the shutter sees them."""
        if not images:
            return {}
        every = np.concatenate([*images.values()], 1)
        every = over_shutter(every, sharp.depth, sharp.motion, sharp.motion_next, self.opens, self.closes)
        ends = np.cumsum([x.shape[1] for x in images.values()])[:-1]
        return dict(zip(images, np.split(every, ends, 1), strict=True))

    def index(self, number: int) -> int:
        """Which of this render's frames has a number."""
        return self.sequence.numbers.index(number)

    @property
    def files(self) -> dict[int, tuple[Path, ...]]:
        """Of each frame, by number."""
        return {frame.number: tuple(frame.files.values()) for frame in self.sequence.files}

    def only(self, layers: Collection[str]) -> Surfaces:
        """Those that give these layers alone."""
        return replace(self, layers=tuple(layer for layer in self.layers if layer in layers))

    def has(self, layer: str) -> bool | None:
        """Whether frames have a layer of this render; None where they keep their own."""
        given = layer in self.layers and self.sequence.has(layer)
        return given if given or (layer in self.layers and layer not in BLURRED) else None


@np.errstate(invalid="ignore", over="ignore")  # broken pixels are compared, and count for nothing
def over_shutter(
    image: np.ndarray,  # [1, C, H, W] at the time of the frame
    depth: np.ndarray,  # [1, 1, H, W], 0: nothing was hit
    motion: np.ndarray,  # [1, 2, H, W] pixels
    motion_next: np.ndarray | None = None,  # likewise
    opens: float = -0.25,  # frames, from the time of the frame
    closes: float = 0.25,
) -> np.ndarray:  # [1, C, H, W]
    """The mean of an image over the time that a shutter is open.

    Surfaces go where `motion` and `motion_next` put them in the frames before and after, on a parabola through both;
    the nearest hides others. What it uncovers shows the farthest beside it. What was hit nowhere stands still.
    """
    _, C, H, W = image.shape
    values = np.zeros((H * W + 1, C), np.float32)  # and of no pixel, -1
    values[:-1] = image[0].reshape(C, -1).T
    far = np.where(depth <= 0, np.inf, depth).ravel()
    speed, bend = whole = _way(motion, motion_next)
    stands = ~np.isfinite(far)
    speed[:, stands] = bend[:, stands] = 0
    longest = np.hypot(*(speed * (closes - opens) + bend * (closes**2 - opens**2))).max()
    if longest < 1:  # pixel
        return image
    order = np.argsort(-far, kind="stable").astype(np.int32)  # so that what is near is written last
    order = order[np.isfinite(values[order]).all(1) & ~np.isnan(far[order])]
    rows, columns = (places.astype(np.float32) for places in np.divmod(order, W))
    speed, bend = speed[:, order], bend[:, order]
    total, times = np.zeros((H * W, C), np.float32), np.zeros((H * W, 1), np.float32)
    count = int(np.clip(math.ceil(longest), LEAST, MOST))
    for t in opens + (closes - opens) * (np.arange(count, dtype=np.float32) + 0.5) / count:
        x = np.rint(columns + speed[0] * t + bend[0] * (t * t))
        y = np.rint(rows + speed[1] * t + bend[1] * (t * t))
        inside = (x >= 0) & (x < W) & (y >= 0) & (y < H)
        shown = np.full(H * W, -1, np.int32)
        shown[_index(y[inside], x[inside], W)] = order[inside]
        grid = shown.reshape(H, W)
        _mend(grid, far)
        holes = np.nonzero(shown < 0)[0]  # as wide as what was there has moved, at most
        if len(holes):
            gone = np.hypot(*(whole[0][:, holes] * t + whole[1][:, holes] * (t * t)))
            _fill(grid, far, np.divmod(holes, W), np.ceil(gone) + 1)
        total += values[shown]
        times += shown[:, None] >= 0
    mean = np.where(times > 0, total / np.maximum(times, 1), values[:-1])
    return np.ascontiguousarray(mean.T).reshape(1, C, H, W)


def _index(rows: np.ndarray, columns: np.ndarray, width: int) -> np.ndarray:
    """Which pixels of a picture these are, int32: counted in whole numbers, as float32 has none beyond 16 million."""
    return rows.astype(np.int32) * np.int32(width) + columns.astype(np.int32)


def _way(motion: np.ndarray, motion_next: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Speed and half the acceleration `[2, H·W]` of each pixel's surface, in pixels and frames."""
    before = motion[0].reshape(2, -1)
    after = -before if motion_next is None else motion_next[0].reshape(2, -1)
    came, goes = (_is_known(way, motion.shape[2:]) for way in (before, after))
    before, after = (np.where(known, way, np.where(other, -opposite, 0)) for known, way, other, opposite in
                     ((came, before, goes, after), (goes, after, came, before)))  # fmt: skip
    return ((after - before) / 2).astype(np.float32), ((after + before) / 2).astype(np.float32)


def _is_known(way: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Whether motion `[2, H·W]` is known. A few pixels that cross half of the picture of `size` (H, W) pass the seam of
    a panorama."""
    half = np.array(size[::-1], np.float32)[:, None] / 2
    known, near = ((np.abs(way) < most).all(0) for most in (OFF_SCREEN, half))
    return near if (known & ~near).mean() < FEW else known


def _mend(shown: np.ndarray, far: np.ndarray) -> None:
    """Where pixels `[H, W]` show none (-1) between two of the same surface, as where it comes nearer, let them show
    that."""
    for down, right in ((0, 1), (1, 0)):
        rows, columns = np.nonzero(shown < 0)
        inside = (rows >= down) & (rows < len(shown) - down) & (columns >= right) & (columns < shown.shape[1] - right)
        rows, columns = rows[inside], columns[inside]
        one, other = shown[rows - down, columns - right], shown[rows + down, columns + right]
        near, away = np.minimum(far[one], far[other]), np.maximum(far[one], far[other])
        same = (one >= 0) & (other >= 0) & (near > SAME * away)
        shown[rows[same], columns[same]] = one[same]


def _fill(shown: np.ndarray, far: np.ndarray, holes: tuple[np.ndarray, np.ndarray], reach: np.ndarray) -> None:
    """Let each of the holes (rows, columns) of pixels `[H, W]`, which show none (-1), show the farthest of those next
    to it in its row and in its column, up to `reach` pixels away; of surfaces as far away the nearest one."""
    rows, columns = holes
    best, steps = np.full(len(rows), -1, np.int32), reach + 1
    for axis, (lines, places) in enumerate(((columns, rows), (rows, columns))):
        chosen, line = np.unique(lines, return_inverse=True)
        strip = shown[:, chosen].T if axis == 0 else shown[chosen]  # those with holes, as rows
        along = np.arange(strip.shape[1], dtype=np.int32)
        before = np.maximum.accumulate(np.where(strip >= 0, along, -1), 1)[line, places]
        after = np.minimum.accumulate(np.where(strip >= 0, along, len(along))[:, ::-1], 1)[:, ::-1][line, places]
        for place in (before, after):
            away = np.abs(place - places)
            found = np.where((place >= 0) & (place < len(along)) & (away <= reach), strip[line, place % len(along)], -1)
            depth, so_far = np.where(found >= 0, far[found], -1), np.where(best >= 0, far[best], 0)
            better = (depth >= SAME * so_far) & ((depth > so_far / SAME) | (away < steps))
            best, steps = np.where(better, found, best), np.where(better, away, steps)
    shown[rows, columns] = best
