"""How deep what is seen in mirrors and through panes seems to lie. numpy only.

A path leads to the first surface that is neither mirror nor glass. What is seen in a flat mirror or through a pane
seems to lie as far along the ray as the path to it is long (docs/notes/virtual_motion.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

DRAWN = 3000  # pixels to which paths are fitted
FIELDS = np.append(0, np.geomspace(0.05, 12, 120))  # (width of the picture / focal length)² that are tried: to 120°
AGREES = 2e-3  # of a depth: what paths are measured to
LEAST = 0.1  # share of the drawn pixels that must agree
LEAST_DRAWN = 6  # pixels that must have depth and path
MOST_SHORT = 0.01  # share of the pixels whose path may be shorter than its first part, as after a wrong fit
LONGER = 1.01  # times the depth of the surface: from then on a path goes on behind it


class Seen(NamedTuple):
    """Of one picture, `[H, W]` each."""

    depth: np.ndarray  # of the surfaces, in units of their median; 0 where it or the path is not known
    behind: np.ndarray  # depth at which what is seen seems to lie, in the same units
    through: np.ndarray  # whether it lies behind the surface, as in a mirror
    ended: np.ndarray  # whether it is the surface itself
    drawn: np.ndarray  # [N] indices of some pixels whose depth and path are known


@np.errstate(all="ignore")  # broken pixels are compared, and count for nothing
def seen_behind(
    depth: np.ndarray,  # [H, W] of the surfaces, along the view
    length: np.ndarray,  # [H, W] of the path from the camera to what is seen
) -> Seen | None:
    """What is seen behind surfaces. Paths may be measured along the ray, and begin at a near plane: the frame tells.
    None where nothing is seen so, and where the frame does not tell how paths are measured."""
    known = (depth > 0) & (length > 0) & np.isfinite(depth) & np.isfinite(length)
    drawn = _draw(known)
    if len(drawn) < LEAST_DRAWN:
        return None
    unit = np.median(depth.flat[drawn])
    depth, length = (np.where(known, image, 0) / unit for image in (depth, length))
    fit = _fit_paths(depth, length, drawn)
    if fit is None:
        return None
    field, near = fit
    x, y = axes(depth.shape)
    behind = length / np.sqrt(1 + np.float32(field) * (x * x + y * y)) + np.float32(near)
    through = known & (behind > LONGER * depth)
    short = known & (behind < depth / LONGER)
    if not through.any() or short.sum() > MOST_SHORT * known.sum():
        return None
    return Seen(depth, behind, through, known & ~through, drawn)


def _fit_paths(depth: np.ndarray, length: np.ndarray, drawn: np.ndarray) -> tuple[float, float] | None:
    """(k, c), so that a path which ends at its first surface has the length sqrt(1 + k r²) (depth - c), with r from the
    middle of the picture in widths: as most of the pixels can agree on. None where too few do."""
    x, y = axes(depth.shape)
    r2 = (x * x + y * y).flat[drawn].astype(np.float64)
    z, d = (image.flat[drawn].astype(np.float64) for image in (depth, length))
    near = np.sort(z - d / np.sqrt(1 + FIELDS[:, None] * r2), axis=1)  # what c each pixel asks for
    counts = np.stack([np.searchsorted(row, row + AGREES) for row in near]) - np.arange(len(drawn))
    row, first = np.unravel_index(counts.argmax(), counts.shape)
    k, c = FIELDS[row], np.median(near[row, first : first + counts[row, first]])
    for _ in range(5):
        stretch = np.sqrt(1 + k * r2)
        left = d - stretch * (z - c)
        agree = np.abs(left) < 2 * AGREES * d
        if not agree.any():
            return None
        slopes = np.stack([r2 * (z - c) / (2 * stretch), -stretch], 1)
        step = np.linalg.lstsq(slopes[agree], left[agree], rcond=None)[0]
        k, c = max(k + step[0], 0.0), c + step[1]
    return (k, c) if agree.mean() > LEAST and -AGREES < c < z.min() else None


def axes(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """x `[1, W]` and y `[H, 1]` of the pixels' centres: in widths, from the middle of the picture."""
    H, W = size
    x, y = ((np.arange(n, dtype=np.float32) + np.float32(0.5 - n / 2)) / np.float32(W) for n in (W, H))
    return x[None], y[:, None]


def _draw(where: np.ndarray) -> np.ndarray:
    """Up to DRAWN pixels of an image, by chance and always the same, of which those count that are meant: indices."""
    drawn = np.random.default_rng(0).integers(where.size, size=DRAWN)
    return drawn[where.flat[drawn]]
