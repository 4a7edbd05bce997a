"""Edges that move against what is behind them: the front over what is behind (Porter and Duff 1984), as recent frames
saw it cover each pixel.

The footprint of a pixel (`ops.recall`) follows one surface. Where two meet that move apart, it holds only one of them,
and what was just uncovered has none. But how far the front covers the pixel is known from frames before: the edge moves
with the front (docs/notes/edges.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..color import albedo_divisor
from ..constants import (
    DEPTH_TOLERANCE,
    FAR_AWAY,
    OVER_APART,
    OVER_LIGHT,
    OVER_SPEED,
    RECALL_FOOTPRINT_WORDS,
    RECALL_SAME,
)
from .dispatch import Fused, Support, falls_back
from .fetch import fetch
from .kept import BESIDE, Path, check_kept, distance, kept_beside

SUPPORT = Support(channels={"seen": (9,), "motion": (2,), "depth": (1,)})
FUSED = Fused("over.over_and_coverage", native=SUPPORT, triton=SUPPORT)


def over(
    seen: Tensor,  # [B, 9, H, W] footprints with the current frame in them: `recall.FOOTPRINT`
    now: Tensor | Sequence[Tensor],  # [B, 9, H, W] the current frame alone; several are joined along channels
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, to the frame before
    depth: Tensor,  # [B, 1, H, W]
    recent: Sequence[Tensor],  # [B, 8, H, W] int32 each (`ops.keep.keep`), the frame before first
) -> Tensor:  # [B, 9, H, W]
    """`seen`, but at edges that move against what is behind them

        s = Σ_j w_j s_j / Σ_j w_j,    w_0 = 1,    w_j = Π_(0<i<j) (1 - reset_i(p_i)) · (1 - |δ_x|) (1 - |δ_y|)

    along the path p_j of the front, δ off the pixels that were looked up. s_j is what frame j saw there, if that was
    the front, and otherwise what is behind it now. The front F and what is behind, B, are the nearest and the farthest
    of a pixel and the four beside it, distances d; there is an edge if

        d_F < (1 - APART) d_B    and    |motion(F) - motion(B)| > SPEED

    Where frame j saw something else, the path goes on with the front that the first of the four pixels beside saw (up,
    left, right, down), and ends if none did: how a front that is out of sight moved is unknown.

    Frames saw the front where something was nearer than √(d_F d_B), or than 2 d_F if nothing is behind. What was nearer
    than the front by more than a surface's tolerance (`constants.DEPTH_TOLERANCE`) passed before both: such a frame
    does not count, w_j = 0. Behind is `seen` at B. Of radiance the share LIGHT is s and the rest `seen`, and where both
    differ by less than kept frames are rounded by (SAME), it stays: even light is even. `constants` has the four as
    OVER_APART ...

    Raises ValueError where the shapes do not fit, or the kept frames are no int32. No gradients.
    """
    return over_and_coverage(seen, now, motion, depth, recent)[0]


@falls_back
def over_and_coverage(
    seen: Tensor, now: Tensor | Sequence[Tensor], motion: Tensor, depth: Tensor, recent: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """`over`, and what it knows of each pixel's coverage, `[B, 3, H, W]`: 1 where the front is seen now, otherwise 0;
    Σ w_j, j > 0, of the frames that saw the front; and of all of them. Zero where there is no such edge."""
    B, _, H, W = seen.shape
    check_kept(recent, (B, RECALL_FOOTPRINT_WORDS, H, W))
    now = [now] if isinstance(now, Tensor) else [*now]
    if sum(part.shape[1] for part in now) != seen.shape[1]:
        raise ValueError(f"expected {seen.shape[1]} channels, got {[part.shape[1] for part in now]}")
    if recent and (run := FUSED(seen=seen, now=now, motion=motion, depth=depth)):
        return run(seen, now, motion, depth, recent)
    front, behind, near, far = _ends(distance(depth))
    onward = fetch(motion, front)
    apart = (onward - fetch(motion, behind)).square().sum(1, keepdim=True) > OVER_SPEED**2
    edge = (near < (1 - OVER_APART) * far) & apart
    between = torch.where(far.isinf(), 2 * near, near.sqrt() * far.sqrt())
    path, back = Path(onward), fetch(seen, behind)
    now_front = distance(depth) < between
    total = torch.where(now_front, torch.cat(now, dim=1), back)
    weights, front_weights = torch.ones_like(depth), torch.zeros_like(depth)
    for kept in recent:
        there = path.look(kept)
        away = distance(there.depth)
        hidden = away < (1 - DEPTH_TOLERANCE) * near
        weight = path.inside * path.left * path.cover * ~hidden
        is_front = (away < between) & ~hidden
        radiance = there.light * albedo_divisor(there.albedo, there.depth)
        total = total + weight * torch.where(is_front, torch.cat([radiance, there.albedo, there.normal], 1), back)
        weights, front_weights = weights + weight, front_weights + weight * is_front
        beside = _front_beside(kept, path.whole, (1 - DEPTH_TOLERANCE) * near, between)
        path.follow(torch.where(is_front, there.motion, beside), there.reset)
    (light, surfaces), (was, _) = (x.split([3, 6], dim=1) for x in (total / weights, seen))
    light = torch.where((light - was).abs() <= RECALL_SAME * was, was, light)
    composed = torch.cat([torch.lerp(was, light, OVER_LIGHT), surfaces], dim=1)
    coverage = torch.cat([now_front, front_weights, weights - 1], dim=1).where(edge, 0)
    return torch.where(edge, composed, seen), coverage


def _front_beside(kept: Tensor, at: Tensor, nearest: Tensor, between: Tensor) -> Tensor:
    """The motion of the front in the first of the four pixels beside that where `at` leads that saw it, `[B, 2, H, W]`;
    off the screen where none did."""
    found = torch.full_like(at, FAR_AWAY)
    for away, motion in reversed([*zip(*kept_beside(kept, at), strict=True)]):
        found = torch.where((away >= nearest) & (away < between), motion, found)
    return found


def _ends(depths: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Of each pixel and the four beside it where the nearest and the farthest are, `[B, 2, H, W]` (x, y) in pixels
    each, and both distances, `[B, 1, H, W]` each; each in turn is nearer or farther by more than OVER_APART or does not
    count."""
    itself = torch.zeros_like(depths).repeat(1, 2, 1, 1)
    front, behind, near, far = itself, itself, depths, depths
    for y, x in BESIDE[1:]:
        beside = torch.cat([itself[:, :1] + x, itself[:, 1:] + y], dim=1)
        other = fetch(depths, beside)
        nearer, farther = other < (1 - OVER_APART) * near, (1 - OVER_APART) * other > far
        front, near = torch.where(nearer, beside, front), torch.where(nearer, other, near)
        behind, far = torch.where(farther, beside, behind), torch.where(farther, other, far)
    return front, behind, near, far
