"""Edges that move, as one pass saw them: the front over what is behind (`ops.over`), where the frame agrees.

Past frames, or later ones, tell how far the front covers a pixel, as long as the edge moves as the front does. The
silhouette of a turning object does not, and what it uncovers is seen by few frames, so that each sample weighs much
(docs/notes/edges.md). The frame itself is a witness: its own samples must show the front as often as the others say.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..frame import Frame, History
from ..models.footprint import footprint_of
from ..models.shrinkage import few_samples
from ..models.window import box
from ..ops.over import over_and_coverage

SIDE = 13  # pixels, odd: of the neighbourhood over which the frame must agree
AGREES = 2.5  # squared difference there, as a multiple of its variance, up to which it does
LEAST_WEIGHT = 0.1  # of other frames, in frames: below, they say nothing
LEAST_VARIANCE = 0.05  # of a sample that shows the front or not: few frames may all have missed a surface


def as_covered(frame: Frame, history: History | None, after: History) -> tuple[Tensor, Tensor]:
    """`after.footprint` of a sanitised frame with edges that move against what is behind them, `[B, 9, H, W]`, and the
    frames in its albedo and normal, `[B, 1, H, W]` ≥ 1: at these edges all that looked there. `history`: before.

    Pixels of FEW_SAMPLES or more stay: their albedo is the mean of both sides of an edge already."""
    if history is None:
        return after.footprint, after.footprint_count
    composed, coverage = over_and_coverage(
        after.footprint, footprint_of(frame), frame.motion, frame.depth, history.recent
    )
    usable = agrees(coverage) & few_samples(frame)
    footprint = torch.where(usable, composed, after.footprint)
    return footprint, torch.where(usable, 1 + coverage[:, 2:], after.footprint_count)


def agrees(coverage: Tensor) -> Tensor:
    """Where edges are, and the frame shows the front as often as the other frames do, `[B, 1, H, W]` bool; `coverage`
    as `over_and_coverage` has it.

    With the front's share c among w other frames and the frame's own sample y, 0 or 1, over SIDE × SIDE pixels

        |Σ (c - y)|² ≤ AGREES Σ v,    v = max(q (1 - q), LEAST_VARIANCE) (1 + 1/w),    q = (w c + y) / (w + 1)

    v is the variance of c - y if all samples are of one coverage."""
    now, front, weight = coverage.split(1, dim=1)
    known = weight > LEAST_WEIGHT
    share, both = front / weight.clamp(min=LEAST_WEIGHT), (front + now) / (weight + 1)
    variance = (both * (1 - both)).clamp(min=LEAST_VARIANCE) * (1 + 1 / weight.clamp(min=LEAST_WEIGHT))
    off, expected = (box(known * x, SIDE) for x in (share - now, variance))
    pixels = F.avg_pool2d(torch.ones_like(now), SIDE, stride=1, padding=SIDE // 2) * SIDE**2  # inside the picture
    return known & (pixels * off.square() <= AGREES * expected)
