"""The pixels around some of an image, and their weights. numpy only."""

from __future__ import annotations

import numpy as np


def around(image: np.ndarray, place: tuple[np.ndarray, np.ndarray], radius: int) -> np.ndarray:
    """The pixels of an image `[H, W, …]` around each place (rows, columns), `[N, (2 radius + 1)², …]` float64; beyond
    its border those at it."""
    rows, columns = (
        at[:, None] + step.ravel() - radius for at, step in zip(place, np.indices((2 * radius + 1,) * 2), strict=True)
    )
    return image[rows.clip(0, image.shape[0] - 1), columns.clip(0, image.shape[1] - 1)].astype(np.float64)


def gaussian(radius: int, deviation: float) -> np.ndarray:
    """Weights `[(2 radius + 1)²]` of the pixels of `around`, with a sum of 1; `deviation` in pixels."""
    one = np.exp(-0.5 * np.square(np.arange(-radius, radius + 1) / deviation))
    return np.outer(one, one).ravel() / one.sum() ** 2
