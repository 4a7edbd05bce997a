"""The mean light of recent frames, moved to the current one along chained motion.

A running mean decays: each lookup mixes neighbours, so that their noise is no longer their own, and a frame that is
rejected once is lost. Here the frames themselves are kept, and each new frame looks all of them up, at the nearest
pixel (docs/notes/recall.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import albedo_divisor
from ..constants import (
    DEPTH_TOLERANCE,
    RECALL_ALIKE,
    RECALL_CELL,
    RECALL_CHANGED,
    RECALL_FOOTPRINT_WORDS,
    RECALL_JOINED,
    RECALL_ROUNDING,
    RECALL_WHITE,
    RECALL_WIDE_ALIKE,
    RECALL_WIDE_CHANGED,
    RECALL_WORDS,
)
from .alike import alike
from .dispatch import Fused, Support, falls_back
from .kept import BESIDE, Path, check_kept, distance, edge_motion

FOOTPRINT = 3, 3, 3  # channels of a footprint: radiance, albedo, normal
SUPPORT = Support(channels={"light": (3,), "motion": (2,), "surface": (1, 3)})
FUSED = Fused("recall", native=SUPPORT, triton=SUPPORT)


@dataclass(frozen=True)
class Recalled:
    """What `recall` found of each pixel in recent frames. Zero where there is nothing."""

    light: Tensor  # [B, 3, H, W] weighted mean of the light on its surface
    count: Tensor  # [B, 1, H, W] sum of the weights
    footprint: Tensor | None = None  # [B, 9, H, W] weighted mean of `FOOTPRINT`, whatever surface of the pixel it was
    footprint_count: Tensor | None = None  # [B, 1, H, W] sum of those weights


@falls_back
def recall(
    light: Tensor,  # [B, 3, H, W] of the current frame
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, to the frame before
    surface: tuple[Tensor, Tensor],  # depth [B, 1, H, W] and normal [B, 3, H, W] of the current frame
    recent: Sequence[Tensor],  # [B, 5, H, W] int32 each (`ops.keep`), the frame before first; 8 channels for footprints
    uncovered: Tensor | None = None,  # [B, 1, H, W] bool: for footprints, what a moving object has just uncovered
    misplaced: Tensor | None = None,  # [B, 1, 1, 1] ≥ 0, for footprints: how much less lookups off the pixel count
    lone: Tensor | None = None,  # [B, 2, H, W] `scattered`, for footprints: depths of what is hit here and there
) -> Recalled:
    """The weighted mean of the frames' light:

        p_1 = p + motion(p),    p_(j+1) = p_j + motion_j(p_j),    at the nearest pixel; a path ends off the screen
        w_j = same surface · u_j · Π_(i<j) (1 - reset_i(p_i)),
        u_j = clamp((CHANGED - q_j) / (CHANGED - ALIKE), 0, 1) · the same of wider cells
              · clamp((JOINED - r_j) / (JOINED - WHITE), 0, 1),
        q_j = |Σ d|² / Σ (|d|² + ROUNDING · light),    r_j = Σ (d d_x + d d_y) / Σ (|d|² + ROUNDING · light)

    with the differences d = √light_j(p_j) - √light(p), over cells of CELL × CELL pixels and the eight around them, of
    pixels that show the same surface (`alike`): q_j is 1 on average if they are noise alone, and small if they are what
    bfloat16 rounds. The root keeps a few bright samples from being all that counts. Cells of twice the side tell of
    weaker changes: what is common to more pixels stands out from their noise. Noise is white, what has changed is not:
    r_j is the correlation of d with that of the pixel beside and below, over pairs of pixels that lie together in a
    cell. `constants` has these numbers as RECALL_CELL, RECALL_WIDE_ALIKE ...

    With `uncovered` also the mean of all that was seen in the pixel. At an edge one sample shows one of two surfaces, a
    converged picture both: so the surface there need only be that of p or of a pixel beside it. An edge moves with what
    is in front, so these paths begin with `edge_motion` and follow it, and what is in front of the surface that they
    follow does not belong to the pixel, unless it is hit here and there around (`lone`): what is out of focus counts
    wherever it was hit. What was just uncovered has no footprint yet: its path would lead through what covered
    it. A lookup at the nearest pixel that is off by δ counts as much as the two pixels cover each other, and less where
    there is little noise to average (`misplaced`, m):

        w_j = not uncovered · surface of the pixel · u_j · Π_(i<j) (1 - reset_i(p_i)) · c(δ),
        c(δ) = (1 - |δ_x|) (1 - |δ_y|) / (1 + m |δ|²)

    Raises ValueError where the shapes do not fit, or the kept frames are no int32. No gradients.
    """
    B, _, H, W = light.shape
    check_kept(recent, (B, RECALL_WORDS if uncovered is None else RECALL_FOOTPRINT_WORDS, H, W))
    if uncovered is not None and (uncovered.shape != (B, 1, H, W) or uncovered.dtype is not torch.bool):
        raise ValueError(f"expected uncovered {(B, 1, H, W)} bool, got {tuple(uncovered.shape)} {uncovered.dtype}")
    if recent and (run := FUSED(light=light, motion=motion, surface=surface)):
        return Recalled(*run(light, motion, *surface, recent, uncovered, misplaced, lone))
    mean, count = torch.zeros_like(light), torch.zeros_like(light[:, :1])
    seen, seen_count = light.new_zeros(B, sum(FOOTPRINT), H, W), torch.zeros_like(count)
    path, edge, root = Path(motion), None, _root(light)
    least = RECALL_ROUNDING * root.square().sum(1, keepdim=True)
    if uncovered is not None:
        along, nearest = edge_motion(motion, surface[0])
        edge = Path(along)
    for kept in recent:
        there = path.look(kept)
        same = (alike(surface, (there.depth, there.normal)) & path.inside).to(light.dtype)
        difference = same * (_root(there.light) - root)
        stays = unchanged(difference, same * least) * white(difference, same * least)
        weight = same * stays * path.left
        mean, count = mean + weight * there.light, count + weight
        path.follow(there.motion, there.reset)
        if edge is not None:
            there = edge.look(kept)
            other = there.depth, there.normal
            shown = _beside(surface, other) & (distance(there.depth) >= (1 - DEPTH_TOLERANCE) * nearest)
            if lone is not None:
                shown |= (there.depth >= lone[:, :1]) & (there.depth <= lone[:, 1:])
            weight = (shown & edge.inside & ~uncovered) * stays * edge.left * edge.cover
            if misplaced is not None:
                weight = weight / (1 + misplaced * edge.off)
            radiance = there.light * albedo_divisor(there.albedo, there.depth)
            seen = seen + weight * torch.cat([radiance, there.albedo, there.normal], dim=1)
            seen_count = seen_count + weight
            edge.follow(there.edge, there.reset)
    found = mean / count.clamp(min=1e-6), count
    return Recalled(*found, *(() if edge is None else (seen / seen_count.clamp(min=1e-6), seen_count)))


def unchanged(difference: Tensor, least: Tensor, patience: float = 1.0) -> Tensor:
    """The first factors of u_j, by q_j, `[B, 1, H, W]`, from the differences `[B, 3, H, W]` and what is added to their
    squares, `[B, 1, H, W]`: both are 0 on other surfaces. `patience`: the bounds of q are so many times as high."""
    (H, W), wide = difference.shape[2:], 2 * RECALL_CELL
    square = patience * (difference.square().sum(1, keepdim=True) + least)
    terms = F.pad(torch.cat([difference, square], dim=1), (0, -W % wide, 0, -H % wide))
    cells = F.avg_pool2d(terms, RECALL_CELL) * RECALL_CELL**2
    weight = _unchanged(4 * F.avg_pool2d(cells, 2), RECALL_WIDE_ALIKE, RECALL_WIDE_CHANGED)
    weight = F.interpolate(weight, scale_factor=2) * _unchanged(cells, RECALL_ALIKE, RECALL_CHANGED)
    return F.interpolate(weight, scale_factor=RECALL_CELL)[:, :, :H, :W]


def _unchanged(cells: Tensor, whole: float, none: float) -> Tensor:
    """Its part for cells with these sums: light counts `whole` up to that q, and not at all from `none` on."""
    sums = 9 * F.avg_pool2d(cells, 3, stride=1, padding=1)
    q = sums[:, :3].square().sum(1, keepdim=True) / sums[:, 3:].clamp(min=1e-30)
    return ((none - q) / (none - whole)).clamp(0, 1)


def white(difference: Tensor, least: Tensor) -> Tensor:
    """The last factor of u_j, likewise, by r_j."""
    H, W = difference.shape[2:]
    square = difference.square().sum(1, keepdim=True) + least
    difference, square = (F.pad(x, (0, -W % RECALL_CELL, 0, -H % RECALL_CELL)) for x in (difference, square))
    beside = (difference[..., 0::2] * difference[..., 1::2]).sum(1, keepdim=True)
    below = (difference[..., 0::2, :] * difference[..., 1::2, :]).sum(1, keepdim=True)
    half = RECALL_CELL // 2
    products = (F.avg_pool2d(beside, (RECALL_CELL, half)) + F.avg_pool2d(below, (half, RECALL_CELL))) / 2
    products, square = (F.avg_pool2d(mean, 3, 1, 1) for mean in (products, F.avg_pool2d(square, RECALL_CELL)))
    r = products / square.clamp(min=1e-30)
    weight = ((RECALL_JOINED - r) / (RECALL_JOINED - RECALL_WHITE)).clamp(0, 1)
    return F.interpolate(weight, scale_factor=RECALL_CELL)[:, :, :H, :W]


def _root(light: Tensor) -> Tensor:
    return light.clamp(min=0).sqrt()


def _beside(surface: tuple[Tensor, Tensor], other: tuple[Tensor, Tensor]) -> Tensor:
    """Whether `other` may be the surface of a pixel or of the four beside it, `[B, 1, H, W]` bool."""
    H, W = other[0].shape[2:]
    padded = [F.pad(image, (1, 1, 1, 1), mode="replicate") for image in surface]
    found = torch.zeros_like(other[0], dtype=torch.bool)
    for y, x in BESIDE:
        found |= alike(tuple(image[..., 1 + y : 1 + y + H, 1 + x : 1 + x + W] for image in padded), other)
    return found
