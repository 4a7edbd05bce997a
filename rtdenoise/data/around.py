"""The pixels around those of an image, and their weights. numpy only."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

EIGHT = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if y or x]  # steps to the pixels around one


def shifted(image: np.ndarray, steps: Iterable[tuple[int, int]], radius: int) -> Iterator[np.ndarray]:
    """For each step (y, x), of `radius` pixels at most, what is there from every pixel of an image `[…, H, W]`; beyond
    its border what is at it."""
    H, W = image.shape[-2:]
    wide = np.pad(image, [(0, 0)] * (image.ndim - 2) + [(radius, radius)] * 2, mode="edge")
    for y, x in steps:
        yield wide[..., radius + y : radius + y + H, radius + x : radius + x + W]


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


def beside_each(place: np.ndarray, image: np.ndarray) -> np.ndarray:
    """The indices `[8, N]` of the pixels around places `[N]`, indices of pixels of an image `[H, W]`, none of them at
    its border."""
    return place + np.array([[y * image.shape[1] + x] for y, x in EIGHT])


def groups(place: np.ndarray, image: np.ndarray) -> np.ndarray:
    """A label `[N]` of each place, as in `beside_each`, the same in [0, N) for all that hang together."""
    label = np.arange(len(place))
    index = np.full(image.size, -1)
    index[place] = label
    beside = index.take(beside_each(place, image))
    beside = np.where(beside < 0, label, beside)
    while True:  # a label is the index of a place that hangs together with it, in the end the greatest
        greatest = np.maximum(label, label[beside].max(0))
        if np.array_equal(greatest, label):
            return label
        np.maximum.at(greatest, label, greatest.copy())
        label = greatest[greatest]
