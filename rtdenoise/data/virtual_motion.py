"""Virtual motion: how what is seen in flat mirrors and through panes moves. numpy only.

A renderer's motion is that of the surface which a ray hits first. What is seen in a flat mirror or through a pane lies
deeper, as far along the ray as the path to it is long, and if both stand still it moves as a surface at that depth
would. So the camera's motion, which gives that of any depth, is fitted to all that stands still
(docs/notes/virtual_motion.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..frame import Frame
from .around import EIGHT, shifted
from .ended import with_seen_albedo
from .virtual_depth import AGREES, axes, seen_behind

LEAST = 0.1  # share of the drawn pixels that must agree
TRIALS, POINTS = 300, 6  # cameras that are tried, and pixels to which each is fitted: 11 unknowns
MOVES_ALIKE, STANDS = 0.05, 1e-3  # pixels a frame
DISTINCT = 1e-3  # how far from ambiguous a fit must be, as where all surfaces lie in one plane
CELL, CELLS, LEAST_FLAT = 16, 20, 16  # pixels at least, or a part of the width: of a cell; pixels of a mirror in it
FLAT = 0.01  # how far normals differ in a cell of a mirror that is flat
SAME_DEPTH, SAME_ALBEDO = 0.1, 0.2  # pixels are alike: relative; of each channel
LEAST_ALIKE = 3  # of the pixels around, for one to be no stray


@np.errstate(all="ignore")  # broken pixels are compared, and count for nothing
def with_virtual_motion(
    frame: Frame,  # numpy arrays with albedo, normal, depth and motion, of one picture
    length: np.ndarray,  # [1, 1, H, W] of the path from the camera to what is seen
) -> Frame:
    """The frame with `motion` and `motion_next` of what is seen in flat mirrors and through panes that stand still, and
    with the albedo of that.

    A path leads to the first surface that is neither mirror nor glass. Its length may be measured along the ray where
    depth is measured along the view, and begin at a near plane: the frame tells. What is seen has the pixel's albedo.
    Where that and the path are unlike those around, as where a pane reflects one sample of many, both are taken from a
    pixel beside it. Dots whose path ended at a mirror of any kind have the albedo of what is seen around them.

    Motion stays where the camera stands still, where no camera that maps straight lines to straight lines fits, and
    where what stands still lies in one plane, so that it does not tell of other depths. The frame itself where nothing
    is seen in mirrors or through panes.
    """
    motions = {name: motion for name in ("motion", "motion_next") if (motion := getattr(frame, name)) is not None}
    if len(frame.radiance) != 1 or any(x is None for x in (frame.albedo, frame.normal, frame.depth, frame.motion)):
        return frame
    seen = seen_behind(frame.depth[0, 0], length[0, 0])
    if seen is None:
        return frame
    frame = with_seen_albedo(frame, seen)
    depth, behind, drawn = seen.depth, seen.behind, seen.drawn
    through = seen.through & _is_flat(frame.normal[0], seen.through)
    plain = drawn[np.abs(behind - depth).flat[drawn] < AGREES * depth.flat[drawn]]
    cameras = {name: _fit_camera(depth, motion[0], plain) for name, motion in motions.items()}
    cameras = {name: camera for name, camera in cameras.items() if camera is not None}
    if not cameras:
        return frame
    place = np.nonzero(through)
    for name, camera in cameras.items():
        through[place] &= np.abs(_moved(camera, place, depth) - motions[name][0][:, *place]).max(0) < 2 * MOVES_ALIKE
    place, albedo = np.nonzero(through), frame.albedo.copy()
    strays, beside = _strays(through, behind, albedo[0])
    behind[strays], albedo[0][:, *strays] = behind[beside], albedo[0][:, *beside]
    for name, camera in cameras.items():
        motions[name] = motions[name].copy()
        motions[name][0][:, *place] = _moved(camera, place, behind)
    return replace(frame, albedo=albedo, **motions)


def _fit_camera(depth: np.ndarray, motion: np.ndarray, drawn: np.ndarray) -> np.ndarray | None:
    """The matrix `[3, 4]` that takes (x, y, 1, 1 / depth) of what stands still, x and y in widths from the middle of
    the picture, to its place on the other frame, in homogeneous coordinates. Direct linear transform of the pixels on
    which most agree (Hartley and Zisserman, "Multiple View Geometry in Computer Vision", 2004, 4.1 and 4.7). None where
    too few do, where that is ambiguous, and where most stand still on the picture."""
    W = depth.shape[1]
    step = motion.reshape(2, -1)[:, drawn].T.astype(np.float64) / W
    here = _points(np.unravel_index(drawn, depth.shape), depth).T.astype(np.float64)
    finite = np.isfinite(here).all(1) & np.isfinite(step).all(1)
    here, step = here[finite], step[finite]
    if len(here) < POINTS or np.median(np.abs(step).max(1)) * W < STANDS:
        return None
    there, none = here[:, :2] + step, np.zeros_like(here)
    rows = np.stack([np.concatenate([here, none, -there[:, :1] * here], 1),
                     np.concatenate([none, here, -there[:, 1:] * here], 1)], 1)  # fmt: skip
    chance = np.random.default_rng(0).integers(len(here), size=(TRIALS, POINTS))
    cameras = np.linalg.svd(rows[chance].reshape(TRIALS, 2 * POINTS, 12))[2][:, -1].reshape(TRIALS, 3, 4)
    agree = _off(cameras, here, there) * W < MOVES_ALIKE
    agree = agree[agree.sum(1).argmax()]
    for _ in range(3):
        if agree.sum() < max(POINTS, LEAST * len(here)):
            return None
        _, sizes, vectors = np.linalg.svd(rows[agree].reshape(-1, 12), full_matrices=False)
        camera = vectors[-1].reshape(3, 4)
        agree = _off(camera[None], here, there)[0] * W < MOVES_ALIKE
    return camera.astype(np.float32) if sizes[-2] > DISTINCT * sizes[0] else None


def _off(cameras: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """How far each of the cameras `[K, 3, 4]` takes points `[N, 4]` from places `[N, 2]`: `[K, N]` widths."""
    x, y, w = np.moveaxis(here @ cameras.transpose(0, 2, 1), 2, 0)
    return np.nan_to_num(np.hypot(x / w - there[:, 0], y / w - there[:, 1]), nan=np.inf, posinf=np.inf)


def _moved(camera: np.ndarray, place: tuple[np.ndarray, np.ndarray], depth: np.ndarray) -> np.ndarray:
    """The motion `[2, N]` in pixels of what stands still, at places (rows, columns) of a depth `[H, W]`."""
    points = _points(place, depth)
    x, y, w = camera @ points
    return np.nan_to_num(np.stack([x / w - points[0], y / w - points[1]]) * np.float32(depth.shape[1]))


def _points(place: tuple[np.ndarray, np.ndarray], depth: np.ndarray) -> np.ndarray:
    """(x, y, 1, 1 / depth) at places (rows, columns), `[4, N]`; x and y as `axes`."""
    x, y = axes(depth.shape)
    return np.stack([x[0, place[1]], y[place[0], 0], np.ones(len(place[0]), np.float32), 1 / depth[place]])


def _is_flat(normal: np.ndarray, where: np.ndarray) -> np.ndarray:
    """The cells `[H, W]` with enough pixels that are meant, whose normals `[3, H, W]` differ by FLAT at most. Of a part
    of the picture's width, so that a curve is one at every size."""
    H, W = where.shape
    n = max(CELL, W // CELLS)

    def cells(image: np.ndarray, fill: float, pick: Callable) -> np.ndarray:
        edged = np.pad(image, [(0, 0), (0, -H % n), (0, -W % n)], constant_values=fill)
        return pick(pick(edged.reshape(len(image), -1, n, edged.shape[2]), 2).reshape(len(image), -(-H // n), -1, n), 3)

    most = cells(np.where(where, normal, np.float32(-np.inf)), -np.inf, np.max)
    least = cells(np.where(where, normal, np.float32(np.inf)), np.inf, np.min)
    flat = (most - least <= FLAT).all(0) & (cells(where[None], False, np.sum)[0] >= LEAST_FLAT)
    return flat.repeat(n, 0).repeat(n, 1)[:H, :W]


def _strays(where: np.ndarray, behind: np.ndarray, albedo: np.ndarray) -> tuple[tuple, tuple]:
    """The pixels that show otherwise than those around, and the pixel beside each that is most like those around: rows
    and columns of both. A line as thin as a pixel is no stray."""
    behind, like = np.where(where, behind, np.float32(-1)), []
    for its_depth, *its_albedo in shifted(np.concatenate([behind[None], albedo]), EIGHT, 1):
        alike = (its_depth > 0) & (np.abs(its_depth - behind) < SAME_DEPTH * behind)
        for its, own in zip(its_albedo, albedo, strict=True):
            alike &= np.abs(its - own) < SAME_ALBEDO
        like.append(alike)
    line = np.logical_or.reduce([like[i] & like[-1 - i] for i in range(4)])
    count = np.where(where, np.sum(like, axis=0, dtype=np.int8), 0)
    strays = np.nonzero(where & (count < LEAST_ALIKE) & ~line)
    beside = np.stack([there[strays] for there in shifted(count, EIGHT, 1)])
    better = beside.max(0) > count[strays]
    strays, steps = tuple(at[better] for at in strays), np.array(EIGHT)[beside.argmax(0)[better]].T
    return strays, tuple((at + step).clip(0, n - 1) for at, step, n in zip(strays, steps, where.shape, strict=True))
