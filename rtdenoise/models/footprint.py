"""What a pixel shows, from the frames before and after: the light, albedo and normal of its footprint."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..constants import RECALL_SAME, RESET_MORE
from ..frame import NOTHING_KNOWN, Frame, History, Known
from ..ops.over import over, over_and_coverage
from ..ops.pixels import accumulate, joined
from .past import Past, nearest, of_many

if TYPE_CHECKING:
    from .presets import Config


def reset_of_footprint(config: Config, frame: Frame, past: Past, said: Tensor, reset: Tensor) -> Tensor:
    """How far footprints give way: `reset`, as light does. With `Frame.more_history` half of what a network for many
    samples `said` counts (docs/notes/many.md)."""
    return past.giving_way(RESET_MORE * said) if of_many(config) and frame.more_history else reset


def footprint(frame: Frame, past: Past, reset: Tensor) -> tuple[Tensor, Tensor]:
    """`History.footprint` and `footprint_count` of a sanitised frame. `reset`: how far what recent frames saw gives
    way to it."""
    seen = footprint_of(frame)
    if past.footprint is None:
        return torch.cat(seen, dim=1), torch.ones_like(frame.depth)
    return accumulate(seen, past.footprint, past.footprint_count, reset, torch.inf, RECALL_SAME)


def footprint_of(frame: Frame) -> tuple[Tensor, Tensor, Tensor]:
    """What one frame sees in each pixel: the parts of `recall.FOOTPRINT`."""
    return frame.radiance, frame.albedo, frame.normal


def seen(
    frame: Frame, history: History | None, after: History, known: Known = NOTHING_KNOWN, later: History | None = None
) -> Tensor:
    """`after.footprint` of a sanitised frame of one sample a pixel, with edges that move against what is behind them
    (`ops.over`), `[B, 9, H, W]`: for networks that filter what a pixel shows. `later`: what the function returns. Where
    frames before and frames after know such an edge, it is their mean, weighted by the frames that looked there."""
    seen, now, sides = after.footprint, footprint_of(frame), []
    if history is not None and history.recent and not known.still:
        sides.append((frame.motion, nearest(history, known).recent))
    if later is not None:
        sides.append((frame.motion_next, later.recent))
    if len(sides) < 2:
        return over(seen, now, sides[0][0], frame.depth, sides[0][1]) if sides else seen
    (a, of_a), (b, of_b) = (over_and_coverage(seen, now, motion, frame.depth, recent) for motion, recent in sides)
    n, m = ((1 + c[:, 2:]) * (c.amax(1, keepdim=True) > 0) for c in (of_a, of_b))  # 0: `seen`, as there is no edge
    return joined(a, n, b, m)[0]
