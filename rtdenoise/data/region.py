"""A render region of Blender in frames that are not cropped to it. numpy only.

What lies beyond it was never rendered, and is no background: networks and soft edges would mix its black into the rim.
So the region is mirrored beyond its rim while frames are denoised, and what lies there is taken away in the result.
Pixels that are repeated would do worse: the noise of each would be a stripe.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..frame import Frame

NEVER = 5e10  # Blender fills depth with 1e11 before it renders; where nothing is hit Cycles writes 1e10


@dataclass(frozen=True)
class Region:
    """Rows and columns of the region, as slices."""

    rows: slice
    columns: slice

    def size(self, height: int, width: int) -> tuple[int, int]:
        """(H, W) of frames as they are read."""
        return height, width

    def around(self, plane: np.ndarray) -> np.ndarray:
        """A channel `[H, W]` with the region mirrored beyond its rim."""
        rows, columns = map(_folded, plane.shape, (self.rows, self.columns))
        return plane[rows[:, None], columns]

    def cropped(self, image: np.ndarray) -> np.ndarray:
        """The region of an image `[…, H, W]`."""
        return image[..., self.rows, self.columns]

    def within(self, image: np.ndarray) -> np.ndarray:
        """An image `[…, H, W]` with 0 beyond the region."""
        out = np.zeros_like(image)
        out[..., self.rows, self.columns] = self.cropped(image)
        return out

    def joined(self, frame: Frame) -> Frame:
        """A frame that was read so, as it is."""
        return frame


def _folded(n: int, there: slice) -> np.ndarray:
    """For each of n pixels, [n], the one of the slice that is seen there."""
    size = there.stop - there.start
    place = (np.arange(n) - there.start) % (2 * size)
    return there.start + np.minimum(place, 2 * size - 1 - place)


def find_region(
    depth: np.ndarray,  # [H, W] as Blender stores it
) -> Region | None:
    """The region that was rendered, where it is a rectangle and not all."""
    rendered = ~(depth > NEVER)
    if rendered.all() or not rendered.any():
        return None
    rows, columns = (slice(at[0], at[-1] + 1) for at in (np.flatnonzero(rendered.any(axis)) for axis in (1, 0)))
    return Region(rows, columns) if rendered[rows, columns].all() else None
