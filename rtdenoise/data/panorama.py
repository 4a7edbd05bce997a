"""Panoramas, whose left and right edges meet: frames twice as wide as high that show all that is around. numpy only.

A filter takes the edges of a picture for its end. So a frame is read with columns of the other side beside either edge,
and these are taken away from the result. A surface that passes the edge appears on the other side: a renderer may write
a motion of nearly the whole width for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..frame import Frame

LEAST, PART, WHOLE = 64, 16, 16  # columns beside an edge: so many, or such a part of the width; a multiple of these
MEET = 0.9  # share of the rows in which both edges show the same surface
SAME_DEPTH, SAME_NORMAL = 0.1, 0.9  # relative; cosine
LEAST_ROWS = 0.25  # share of the rows in which both edges show a surface: two of sky tell nothing
MOST, FACING = 4000, 0.85  # pixels that are examined; share of what is seen that faces the camera


@dataclass(frozen=True)
class Panorama:
    """A panorama `width` pixels wide."""

    width: int

    @property
    def beside(self) -> int:
        """Columns beside either edge."""
        return min(max(LEAST, self.width // PART), self.width // 2) // WHOLE * WHOLE

    def size(self, height: int, width: int) -> tuple[int, int]:
        """(H, W) of frames as they are read."""
        return height, width + 2 * self.beside

    def around(self, plane: np.ndarray) -> np.ndarray:
        """A channel `[H, W]` with the columns beside its edges, `[H, W + 2 beside]`."""
        return plane[:, np.arange(-self.beside, self.width + self.beside) % self.width]

    def within(self, image: np.ndarray) -> np.ndarray:
        """An image `[…, H, W + 2 beside]` without them."""
        return image[..., self.beside : self.beside + self.width]

    def joined(self, frame: Frame) -> Frame:
        """A frame whose motion takes the shorter way round."""
        motions = {name: motion for name in ("motion", "motion_next") if (motion := getattr(frame, name)) is not None}
        return replace(frame, **{name: self._shorter(motion) for name, motion in motions.items()})

    def _shorter(self, motion: np.ndarray) -> np.ndarray:
        """What is farther than the picture is wide is nowhere (`frame.OFF_SCREEN`), and stays there."""
        x = motion[:, :1]
        far = (np.abs(x) > self.width / 2) & (np.abs(x) < self.width)
        return np.concatenate([np.where(far, x - np.copysign(np.float32(self.width), x), x), motion[:, 1:]], axis=1)


def find_panorama(
    frame: Frame,  # numpy arrays with depth and normal, of one picture
) -> Panorama | None:
    """The panorama that a frame is: twice as wide as high, it has the same surfaces at both edges, and what is seen
    faces a camera that looks around."""
    H, W = frame.size
    if W != 2 * H or W < 2 * WHOLE or frame.depth is None or frame.normal is None:
        return None
    depth, normal = frame.depth[0, 0], frame.normal[0]
    return Panorama(W) if _edges_meet(depth, normal) and _looks_around(depth, normal) else None


def _edges_meet(depth: np.ndarray, normal: np.ndarray) -> bool:
    left, right = depth[:, 0], depth[:, -1]
    hit, nothing = (left > 0) & (right > 0), ~(left > 0) & ~(right > 0)
    a, b = normal[..., 0], normal[..., -1]
    with np.errstate(all="ignore"):  # broken values are no surface
        alike = (a * b).sum(0) > SAME_NORMAL * np.sqrt((a * a).sum(0) * (b * b).sum(0))
        same = hit & (np.abs(left - right) < SAME_DEPTH * np.minimum(left, right)) & alike
    return hit.mean() >= LEAST_ROWS and (same | nothing).mean() >= MEET


def _looks_around(depth: np.ndarray, normal: np.ndarray) -> bool:
    """Whether normals face a camera with the directions of an equirectangular panorama, turned as fits them best
    (Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976; mirrored, too). In other pictures
    what is seen faces one side."""
    H, W = depth.shape
    y, x = np.nonzero((depth > 0) & np.isfinite(normal).all(0))
    y, x = (place[:: -(-len(place) // MOST)] if len(place) else place for place in (y, x))
    turn, rise = 2 * np.pi * (x + 0.5) / W, np.pi * (0.5 - (y + 0.5) / H)
    views = np.stack([np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)])
    normals, weight = normal[:, y, x].astype(np.float64), np.cos(rise)  # of the sphere that a pixel covers
    u, _, vt = np.linalg.svd(weight * normals @ views.T)
    facing = (normals * (u @ vt @ views)).sum(0) > 0  # the directions that are looked in are the opposite
    return (weight * facing).sum() >= FACING * weight.sum() > 0
