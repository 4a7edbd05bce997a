"""Statistics of the motion in pairs of consecutive frames, for `inspect`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..frame import OFF_SCREEN, Frame
from ..motion import dual_motion, occlusion_mask, on_screen
from ..splat import splat_motion_next


@dataclass(frozen=True)
class MotionStatistics:
    """Statistics over the pixels of the examined frames whose motion is known (`frame.OFF_SCREEN`), in pixels."""

    mean: float
    p50: float
    p99: float
    max: float
    still: float  # share of pixels with zero motion
    off_screen: float  # share of pixels with a previous position outside the picture
    uncovered: float | None  # share of pixels just uncovered; None: motion_next and depth are missing
    unknown: float  # share of all pixels whose motion is not known, such as that of a sky before a moving camera


def motion_statistics(pairs: list[tuple[Frame, Frame]]) -> MotionStatistics:
    """Statistics of the second frame of each pair."""
    motions = [current.motion for _, current in pairs]
    known = [(m.abs() < OFF_SCREEN).all(1) for m in motions]
    length = torch.cat([torch.hypot(*m.unbind(1))[there] for m, there in zip(motions, known, strict=True)])
    length = length if len(length) else torch.zeros(1)
    ordered = length.sort().values  # torch.quantile takes fewer values than a large picture has

    def at(share: float) -> float:
        return ordered[round(share * (len(ordered) - 1))].item()

    return MotionStatistics(
        mean=length.double().mean().item(),
        p50=at(0.5),
        p99=at(0.99),
        max=at(1.0),
        still=(length == 0).double().mean().item(),
        off_screen=_mean_share([~on_screen(m)[:, 0] & there for m, there in zip(motions, known, strict=True)]),
        uncovered=_mean_share(masks)
        if (masks := [mask for p in pairs if (mask := _uncovered(*p)) is not None])
        else None,
        unknown=_mean_share([~there for there in known]),
    )


def _uncovered(previous: Frame, current: Frame) -> Tensor | None:
    """The occlusion mask by exact or approximate dual motion; None where the layers for both are missing."""
    motion_next = previous.motion_next
    if motion_next is None:
        if previous.depth is None or current.depth is None:
            return None
        motion_next = splat_motion_next(current.motion, current.depth, previous.depth)
    return occlusion_mask(dual_motion(current.motion, motion_next), current.motion)


def _mean_share(masks: list[Tensor]) -> float:
    return sum(mask.double().mean().item() for mask in masks) / len(masks)
