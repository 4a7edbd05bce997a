"""Edges before nothing, of one sample a pixel. numpy only.

One sample hits a surface or passes it: a silhouette before the sky, or before nothing, is a staircase. History makes it
smooth where both move alike. Otherwise networks keep the staircase, as they take it for the picture's. The samples
around tell how far the surface covers a pixel, so that radiance can be that of both (docs/notes/soft_edges.md).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..frame import Frame
from .around import around, gaussian, shifted

COVERAGE, SIDES = (1, 0.6), (2, 1.0)  # radius and standard deviation in pixels: of coverage, and of each side's light
BESIDE = (-1, 0), (0, -1), (0, 1), (1, 0)  # (y, x)
BRIGHT = 100.0  # times the median: brighter samples count as that
BODY, GAP = 2, 3  # pixels across, of what is hit and of what is not: a slanted line of 2 pixels counts all along
APART = 0.5  # pixels a frame: below, history follows both


def with_soft_edges(frame: Frame) -> Frame:
    """A frame of one sample a pixel (numpy arrays) with radiance of the surface and of what is behind it where edges
    move before nothing, as those of `depth` 0 do:

        radiance + (surface - behind) (coverage - hit)

    with the means of both sides' radiance around, of logarithms, so that single bright samples do not spread; hit is 1
    or 0, and coverage its mean around, both with Gaussian weights. So what varies on a surface stays, and so does its
    noise. Edges of what is narrower than 2 pixels, as fur, stay, and so do broken pixels, for `sanitise`. Without
    `motion` all other edges are meant. To the bit the frame where there are none.
    """
    if frame.depth is None:
        return frame
    hit, radiance = frame.depth[0, 0] != 0, np.moveaxis(frame.radiance[0], 0, 2)
    edges = _moving_edges(hit, None if frame.motion is None else frame.motion[0])
    place = _between_bodies(hit, np.nonzero(edges & (np.isfinite(radiance) & (radiance >= 0)).all(2)))
    if not place[0].size:
        return frame
    light = np.nan_to_num(radiance, nan=0, posinf=0, neginf=0).clip(0)
    lights, hits = around(light, place, SIDES[0]), around(hit, place, SIDES[0])[..., None]
    scale = np.median(lights[lights > 0]) if lights.any() else 1.0
    logs = np.log1p(np.minimum(lights / scale, BRIGHT))
    surface, behind = (
        scale * np.expm1((gaussian(*SIDES) @ (share * logs)) / (gaussian(*SIDES) @ share)) for share in (hits, 1 - hits)
    )
    coverage = around(hit, place, COVERAGE[0]) @ gaussian(*COVERAGE)
    soft = radiance.copy()
    soft[place] = (light[place] + (surface - behind) * (coverage - hit[place])[:, None]).clip(0)
    return replace(frame, radiance=np.ascontiguousarray(np.moveaxis(soft, 2, 0))[None])


def _between_bodies(hit: np.ndarray, place: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
    """Of the places those with BODY×BODY pixels nearby that all are hit, and GAP×GAP of which none is: not in fur."""
    near = around(hit, place, 3).reshape(-1, 7, 7)
    between = _has_block(near == 1, BODY) & _has_block(near == 0, GAP)
    return tuple(indices[between] for indices in place)


def _has_block(found: np.ndarray, side: int) -> np.ndarray:
    """Which of N pictures `[N, H, W]` have side×side pixels that all are found."""
    return np.lib.stride_tricks.sliding_window_view(found, (side, side), axis=(1, 2)).all((3, 4)).any((1, 2))


def _moving_edges(hit: np.ndarray, motion: np.ndarray | None) -> np.ndarray:
    """Pixels `[H, W]` beside one of the other side that moves otherwise."""
    other = [there != hit for there in shifted(hit, BESIDE, 1)]
    if motion is not None:
        with np.errstate(invalid="ignore", over="ignore"):
            moves = (np.square(there - motion).sum(0) for there in shifted(motion, BESIDE, 1))
            other = [edge & ~(apart <= APART**2) for edge, apart in zip(other, moves, strict=True)]
    return np.logical_or.reduce(other)
