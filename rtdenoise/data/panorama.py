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
    """The panorama that a frame is: it is twice as wide as high, and its edges show the same surfaces."""
    H, W = frame.size
    if W != 2 * H or W < 2 * WHOLE or frame.depth is None or frame.normal is None:
        return None
    left, right = (frame.depth[0, 0, :, edge] for edge in (0, -1))
    hit = (left > 0) & (right > 0)
    if hit.mean() < LEAST_ROWS:
        return None
    a, b = (frame.normal[0, :, :, edge] for edge in (0, -1))
    with np.errstate(all="ignore"):  # broken values are no surface
        alike = (a * b).sum(0) > SAME_NORMAL * np.sqrt((a * a).sum(0) * (b * b).sum(0))
        same = hit & (np.abs(left - right) < SAME_DEPTH * np.minimum(left, right)) & alike
    nothing = ~(left > 0) & ~(right > 0)
    return Panorama(W) if (same | nothing).mean() >= MEET else None
