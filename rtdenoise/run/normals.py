"""What do the numbers of normals mean? Some renderers store n / 2 + 1/2, and some n in the camera's space.

In world space the normal of a surface stays as it is while the camera turns; in the camera's space all normals turn
with it, in the same way. So one rotation is fitted between the normals of a frame and those of the same surfaces in the
frame before.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from ..frame import OFF_SCREEN, Frame

if TYPE_CHECKING:
    from torch import Tensor

NEARLY = 0.05  # the length of most normals is as far from 1 at most
MANY = 0.25  # least share of the normals whose length tells that they are encoded
POINTS, LEAST = 10_000, 200  # pixels of each pair of frames that are compared, at most and at least
ROUNDS = 5  # of fitting, each to the half that the last one fits best: what moves for itself turns otherwise
VARIED = 1e-3  # least share of the second of three directions: else a turn round the first one is not seen
TURNED, FITS = 0.2, 0.5  # least degrees a frame, and the share of the change between frames that a turn leaves at most
ENCODED = "stored as n / 2 + 1/2, which no preset expects but one of your own"
IN_CAMERA = (
    "those of the same surfaces turn by {:.1f}° a frame: do they lie in the camera's space? Render them in world "
    "space, unless what fills the picture turns"
)


def told_of_normals(frames: Iterable[Frame], pairs: Iterable[tuple[Frame, Frame]] = ()) -> str:
    """What is wrong with the normals of frames of numpy arrays; "" where nothing is found. `pairs` of consecutive
    frames, which have motion, tell whether normals turn, and need torch."""
    frames = [frame for frame in frames if frame.normal is not None]
    if frames and are_encoded(frames):
        return ENCODED
    turns = [turn(before, now) for before, now in pairs if frames]
    seen = [degrees for degrees in turns if degrees]
    return IN_CAMERA.format(np.median(seen)) if 2 * len(seen) >= len(turns) > 0 else ""


def are_encoded(frames: Iterable[Frame]) -> bool:
    """Whether the normals of frames of numpy arrays are stored as n / 2 + 1/2. Black, where nothing was hit, does not
    count."""
    stored = np.concatenate([np.asarray(frame.normal).reshape(3, -1) for frame in frames], axis=1)
    stored = stored[:, stored.any(0)]
    if not stored.size or np.mean(stored < -NEARLY) >= NEARLY:
        return False
    with np.errstate(over="ignore"):  # frames that are examined first are not sanitised
        unit, plain = (np.mean(np.abs(np.linalg.norm(n, axis=0) - 1) < NEARLY) for n in (2 * stored - 1, stored))
    return bool(unit > max(plain, MANY))


def turn(previous: Frame, current: Frame) -> float:
    """Degrees by which the normals of most surfaces have turned since the frame before; 0 where no turn explains how
    they change. The frames have normals and motion `[1, C, H, W]`. Needs torch."""
    import torch

    found = _pairs(*(frame.map(torch.as_tensor) for frame in (previous, current)))
    if found is None:
        return 0.0
    before, now = kept, match = found
    for _ in range(ROUNDS):
        u, sizes, v = torch.linalg.svd(kept.T @ match)
        if sizes[1] < VARIED * sizes.sum():
            return 0.0
        flip = torch.diag(torch.tensor([1.0, 1.0, torch.linalg.det(u @ v).sign()], dtype=u.dtype))
        rotation = u @ flip @ v
        left = (before @ rotation - now).square().sum(1)
        best = left.argsort()[: len(left) // 2]
        kept, match = before[best], now[best]
    angle = ((rotation.trace() - 1) / 2).clamp(-1, 1).acos()
    # No normal changes by more than that. What does was uncovered, or lies at an edge.
    most = (2 * (angle / 2).sin()) ** 2
    changed = (before - now).square().sum(1).clamp(max=most).mean()
    degrees = torch.rad2deg(angle).item()
    return degrees if degrees > TURNED and left.clamp(max=most).mean() < FITS * changed else 0.0


def _pairs(previous: Frame, current: Frame) -> tuple[Tensor, Tensor] | None:
    """[N, 3] normals of the frame before and those of the same surfaces now; None for too few."""
    import torch

    from .conventions import sample

    H, W = current.size
    normal, motion = current.normal[0], current.motion[0]
    known = (motion.abs() < OFF_SCREEN).all(0) & _is_unit(normal)
    y, x = known.nonzero(as_tuple=True)
    chosen = torch.randperm(len(x), generator=torch.Generator().manual_seed(0))[:POINTS]
    y, x = y[chosen], x[chosen]
    from_x, from_y = x + motion[0, y, x], y + motion[1, y, x]
    before = sample(previous.normal.nan_to_num(0, 0, 0), from_x[None], from_y[None])[0]
    there = _is_unit(before) & (from_x >= 0) & (from_x <= W - 1) & (from_y >= 0) & (from_y <= H - 1)
    if there.sum() < LEAST:
        return None
    return before[:, there].T.double(), normal[:, y, x][:, there].T.double()


def _is_unit(normals: Tensor) -> Tensor:
    """Of `[3, …]`."""
    return (normals.square().sum(0).sqrt() - 1).abs() < NEARLY
