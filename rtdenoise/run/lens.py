"""Find a zoom, or a shift of the whole picture, that motion vectors lack: an animated focal length or camera shift.

Where a surface was by its motion, the lens of the frame before may have put it elsewhere. One zoom about the middle of
the picture and one shift are fitted to all textured pixels p of two frames, from coarse to fine:

    now(p) = before(c + (1 + zoom) (q - c) + shift),    q = p + motion(p)

by Gauss-Newton steps in which pixels that differ much count less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ..frame import Frame
from .conventions import MIN_PIXELS, feature_of, sample, textured
from .unmoved import LACKS

LEVELS, ROUNDS = (8, 4, 2, 1), 4  # pixels of a cell, from coarse to fine; steps at each
MOST = 8000  # pixels that are examined in each pair of frames
LEAST_MOTION = 0.5  # pixels at the corner of the picture
LEFT = 0.7  # share of the difference that may be left
NEARER = 0.75  # least share of the pixels that differ less with it: a film on a screen moves by itself
LEFT_IF_KNOWN, NEARER_IF_KNOWN = 0.85, 0.6  # where the shot is known to have one: much may be uncovered in a frame


@dataclass(frozen=True)
class Drift:
    """How the picture moves from the frame before to this one, against its vectors."""

    zoom: float  # growth: 0.01 is 1 % larger; 0 where it moves no pixel by LEAST_MOTION / 2
    shift: tuple[float, float]  # pixels, x right, y down; likewise

    def __str__(self) -> str:
        """In words, with the remedy."""
        x, y = self.shift
        zooms = f"zooms by {self.zoom:+.{1 if abs(self.zoom) > 1e-3 else 2}%} a frame" if self.zoom else ""
        shifts = f"shifts by ({x:+.1f}, {y:+.1f}) px a frame" if x or y else ""
        return LACKS.format(" and ".join(filter(None, (zooms, shifts))))

    def added_to(
        self,
        motion: np.ndarray,  # [1, 2, H, W] pixels, without it
    ) -> np.ndarray:  # [1, 2, H, W]
        """The motion with it: to p + motion, about the middle of the picture, by 1 / (1 + zoom), less the shift."""
        H, W = motion.shape[2:]
        x, y = np.meshgrid(np.arange(W, dtype=np.float32) - (W - 1) / 2, np.arange(H, dtype=np.float32) - (H - 1) / 2)
        pixels, shift = np.stack([x, y])[None], np.float32(self.shift)[:, None, None]
        return ((pixels + motion) / np.float32(1 + self.zoom) - shift - pixels).astype(np.float32)


def find_drift(previous: Frame, current: Frame, known: bool = False) -> Drift | None:
    """The drift of a frame with `motion`; None where there is none, or too little texture in albedo to tell. `known`:
    other frames of the shot have one, so that fewer pixels need to show it."""
    here, before = feature_of(current, "albedo"), feature_of(previous, "albedo")
    if here is None or before is None:
        return None
    y, x = textured(here, current).nonzero(as_tuple=True)
    if len(x) < MIN_PIXELS:
        return None
    chosen = torch.randperm(len(x), generator=torch.Generator().manual_seed(0))[:MOST]
    y, x = y[chosen], x[chosen]
    H, W = current.size
    middle, reach = torch.tensor([(W - 1) / 2, (H - 1) / 2]), math.hypot(W, H) / 2
    pixels = torch.stack([x, y], -1).float()
    there = pixels + current.motion[0, :, y, x].T
    fit = torch.zeros(3)  # zoom · reach, shift
    for cell in LEVELS:
        if 1 < cell > min(H, W) / 8:
            continue
        now, then = (F.avg_pool2d(image, cell, ceil_mode=True, count_include_pad=False) for image in (here, before))
        target = _at(now, pixels, cell)
        slopes = torch.cat([F.pad(then[..., 2:] - then[..., :-2], (1, 1)) / (2 * cell),
                            F.pad(then[:, :, 2:] - then[:, :, :-2], (0, 0, 1, 1)) / (2 * cell)])  # fmt: skip
        for _ in range(ROUNDS):
            place = _moved(there, fit, middle, reach)
            left = target - _at(then, place, cell)
            du, dv = _at(slopes[:1], place, cell), _at(slopes[1:], place, cell)
            rows = torch.stack([(du * (there - middle)[:, 0] + dv * (there - middle)[:, 1]) / reach, du, dv])
            weight = 1 / (1 + (left / left.abs().mean().clamp(min=1e-6)).square())
            normal = torch.einsum("icn,jcn->ij", rows * weight, rows)
            step = torch.linalg.solve(normal + 1e-6 * normal.diagonal().mean().clamp(min=1e-12) * torch.eye(3),
                                      torch.einsum("icn,cn->i", rows * weight, left))  # fmt: skip
            fit = fit + step.clamp(-cell, cell)
    errors = [(target - _at(before, place, 1)).abs().mean(0) for place in (there, _moved(there, fit, middle, reach))]
    bound = 2 * errors[0].mean()  # what lies beyond is uncovered, or off the screen
    as_is, fitted = (error.clamp(max=bound).mean() for error in errors)
    nearer = (errors[1] < errors[0]).float().mean()
    zooms, shifts = fit[0].abs(), fit[1:].norm()
    most, least = (LEFT_IF_KNOWN, NEARER_IF_KNOWN) if known else (LEFT, NEARER)
    if zooms + shifts < LEAST_MOTION or fitted > most * as_is or nearer < least:
        return None
    zoom = 1 / (1 + fit[0].item() / reach) - 1
    shift = tuple((-fit[1:]).tolist())
    return Drift(zoom if zooms >= LEAST_MOTION / 2 else 0.0, shift if shifts >= LEAST_MOTION / 2 else (0.0, 0.0))


def _moved(there: Tensor, fit: Tensor, middle: Tensor, reach: float) -> Tensor:
    return there + fit[0] / reach * (there - middle) + fit[1:]


def _at(image: Tensor, place: Tensor, cell: int) -> Tensor:
    """`[C, N]` at places `[N, 2]` in pixels, of an image of cells."""
    u, v = ((place + 0.5) / cell - 0.5).T
    return sample(image, u[None], v[None])[0]
