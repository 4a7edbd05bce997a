"""Motion blur: surfaces as a shutter sees them that is open for a while. numpy only.

Under motion blur every sample shows another moment, so that one sample's albedo and normal are noise wherever something
moves, and renderers write no motion. A second render without blur tells where every surface is, and how it moves:
where that takes it while the shutter is open, its albedo and normal count in each pixel as long as they are seen there
(docs/notes/motion_blur.md).
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..frame import OFF_SCREEN, Frame

if TYPE_CHECKING:
    from .sequences import Sequence

LEAST, MOST = 16, 32  # moments at which a picture that moves is looked at: as many as the longest way has pixels
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
        shutter sees them."""
        sharp = self.sequence.read(self.sequence.numbers.index(frame.number))
        found = {layer: getattr(sharp, layer) for layer in self.layers}
        blurred = {layer: x for layer, x in found.items() if layer in BLURRED and x is not None}
        if blurred:
            seen = over_shutter(np.concatenate([*blurred.values()], 1), sharp.depth, sharp.motion, sharp.motion_next,
                                self.opens, self.closes)  # fmt: skip
            channels = np.cumsum([x.shape[1] for x in blurred.values()])[:-1]
            found |= zip(blurred, np.split(seen, channels, 1), strict=True)
        return replace(frame, **{layer: x for layer, x in found.items() if x is not None})

    @property
    def files(self) -> dict[int, tuple[Path, ...]]:
        """Of each frame, by number."""
        return {frame.number: tuple(frame.files.values()) for frame in self.sequence.files}

    def only(self, layers: Collection[str]) -> Surfaces:
        """Those that give these layers alone."""
        return replace(self, layers=tuple(layer for layer in self.layers if layer in layers))

    def has(self, layer: str) -> bool:
        """Whether it gives a layer."""
        return layer in self.layers and self.sequence.has(layer)


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
    speed, bend = _way(motion, motion_next)
    far = np.where(depth > 0, depth, np.inf).ravel()
    speed[:, np.isinf(far)] = bend[:, np.isinf(far)] = 0
    ways = [np.hypot(*(speed * t + bend * t * t)) for t in (opens, closes)]
    longest = max(way.max() for way in ways)
    if longest < 0.5:  # pixels
        return image
    order = np.argsort(-far, kind="stable")  # so that what is near is written last
    order = order[np.isfinite(values[order]).all(1) & ~np.isnan(far[order])]
    rows, columns = order // W, order % W
    speed, bend = speed[:, order], bend[:, order]
    total, times = np.zeros((H * W, C), np.float32), np.zeros((H * W, 1), np.float32)
    count = int(np.clip(math.ceil(longest), LEAST, MOST))
    for t in opens + (closes - opens) * (np.arange(count, dtype=np.float32) + 0.5) / count:
        x = np.rint(columns + speed[0] * t + bend[0] * t * t).astype(np.int32)
        y = np.rint(rows + speed[1] * t + bend[1] * t * t).astype(np.int32)
        inside = (x >= 0) & (x < W) & (y >= 0) & (y < H)
        shown = np.full(H * W, -1, np.int32)
        shown[(y * W + x)[inside]] = order[inside]
        shown = _filled(shown, far, W, math.ceil(longest) + 1)
        total += values[shown]
        times += shown[:, None] >= 0
    mean = np.where(times > 0, total / np.maximum(times, 1), values[:-1])
    return np.ascontiguousarray(mean.T).reshape(1, C, H, W)


def _way(motion: np.ndarray, motion_next: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Speed and half the acceleration `[2, H·W]` of each pixel's surface, in pixels and frames."""
    before = motion[0].reshape(2, -1)
    after = -before if motion_next is None else motion_next[0].reshape(2, -1)
    came, goes = ((np.abs(way) < OFF_SCREEN).all(0) for way in (before, after))
    before, after = (np.where(known, way, np.where(other, -opposite, 0)) for known, way, other, opposite in
                     ((came, before, goes, after), (goes, after, came, before)))  # fmt: skip
    return ((after - before) / 2).astype(np.float32), ((after + before) / 2).astype(np.float32)


def _filled(shown: np.ndarray, far: np.ndarray, width: int, reach: int) -> np.ndarray:
    """Pixels `[H·W]` that each pixel shows; where there is none (-1) the farthest of those next to it in its row and in
    its column, up to `reach` pixels away; of surfaces as far away the nearest one."""
    holes = np.nonzero(shown < 0)[0]
    if not len(holes):
        return shown
    places = np.arange(len(shown), dtype=np.int32).reshape(-1, width)
    seen = shown.reshape(-1, width) >= 0
    last, first = np.where(seen, places, -1), np.where(seen, places, len(shown))
    best, steps = np.full(len(holes), -1, np.int32), np.full(len(holes), reach + 1)
    for axis, pitch in ((1, 1), (0, width)):
        before = np.maximum.accumulate(last, axis).ravel()[holes]
        after = np.minimum.accumulate(first[::-1, ::-1], axis)[::-1, ::-1].ravel()[holes]
        for place in (before, after):
            away = np.abs(place - holes) // pitch
            near = (place >= 0) & (place < len(shown)) & (away <= reach)
            found = shown[place[near]]
            depth, so_far = far[found], np.where(best[near] >= 0, far[best[near]], 0)
            better = (depth >= SAME * so_far) & ((depth > so_far / SAME) | (away[near] < steps[near]))
            taken = np.nonzero(near)[0][better]
            best[taken], steps[taken] = found[better], away[taken]
    shown[holes] = best
    return shown
