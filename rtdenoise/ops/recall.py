"""The mean light of recent frames, moved to the current one along chained motion.

A running mean decays: each lookup mixes neighbours, so that their noise is no longer their own, and a frame that is
rejected once is lost. Here the frames themselves are kept, and each new frame looks all of them up, at the nearest
pixel (docs/notes/recall.md).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import FAR_AWAY, RECALL_ALIKE, RECALL_CELL, RECALL_CHANGED, RECALL_WORDS
from .alike import alike
from .dispatch import Fused, Support, falls_back

CHANNELS = 3, 1, 3, 1, 2  # of a kept frame: light, depth, normal, reset, motion
FUSED = Fused("recall", native=Support())
KEEP = Fused("recall.keep", native=Support())


@falls_back
def recall(
    light: Tensor,  # [B, 3, H, W] of the current frame
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, to the frame before
    surface: tuple[Tensor, Tensor],  # depth [B, 1, H, W] and normal [B, 3, H, W] of the current frame
    recent: Sequence[Tensor],  # [B, 5, H, W] int32 each (`keep`), the frame before first
) -> tuple[Tensor, Tensor]:  # [B, 3, H, W], [B, 1, H, W]
    """The weighted mean of the frames' light, and the sum of their weights; 0 where there is none.

        p_1 = p + motion(p),    p_(j+1) = p_j + motion_j(p_j),    at the nearest pixel; a path ends off the screen
        w_j = same surface · clamp((CHANGED - q_j) / (CHANGED - ALIKE), 0, 1) · Π_(i<j) (1 - reset_i(p_i)),
        q_j = |Σ d|² / Σ |d|²

    with the differences d = light_j(p_j) - light(p), over cells of CELL × CELL pixels and the eight around them, of
    pixels that show the same surface (`alike`): q_j is 1 on average if they are noise alone. `constants` has the three
    as RECALL_CELL ... Raises ValueError where the shapes do not fit. No gradients.
    """
    B, _, H, W = light.shape
    for kept in recent:
        if kept.shape != (B, RECALL_WORDS, H, W):
            raise ValueError(f"expected kept frames of {(B, RECALL_WORDS, H, W)}, got {tuple(kept.shape)}")
    if recent and (run := FUSED(light=light, motion=motion, surface=surface)):
        return run(light, motion, *surface, recent)
    x = torch.arange(W, device=motion.device, dtype=motion.dtype)
    y = torch.arange(H, device=motion.device, dtype=motion.dtype)[:, None]
    mean, count, left = torch.zeros_like(light), torch.zeros_like(light[:, :1]), torch.ones_like(light[:, :1])
    for kept in recent:
        whole = torch.nan_to_num(motion, nan=FAR_AWAY).clamp(-FAR_AWAY, FAR_AWAY).round()
        u, v = whole[:, :1] + x, whole[:, 1:] + y
        inside = (u >= 0) & (u < W) & (v >= 0) & (v < H)
        index = (v.clamp(0, H - 1) * W + u.clamp(0, W - 1)).long().reshape(B, 1, H * W)
        there = _unpacked(kept.flatten(2).gather(2, index.expand(B, RECALL_WORDS, -1)).unflatten(2, (H, W)))
        its_light, depth, normal, reset, onward = there.split(CHANNELS, dim=1)
        same = (alike(surface, (depth, normal)) & inside).to(light.dtype)
        weight = left * same * unchanged(same * (its_light - light))
        mean, count, left = mean + weight * its_light, count + weight, left * (1 - reset)
        motion = torch.where(inside, motion + onward, FAR_AWAY)
    return mean / count.clamp(min=1e-6), count


@falls_back
def keep(
    light: Tensor,  # [B, 3, H, W]
    depth: Tensor,  # [B, 1, H, W]
    normal: Tensor,  # [B, 3, H, W]
    reset: Tensor,  # [B, 1, H, W] in [0, 1]: how far light gave way to this frame's; older frames count so much less
    motion: Tensor | None,  # [B, 2, H, W] (x, y) in pixels; paths end at a frame without
) -> Tensor:  # [B, 5, H, W] int32
    """A frame as `recall` takes it: two bfloat16 in each integer, the first in its lower half."""
    if motion is None:
        motion = torch.full_like(light[:, :2], FAR_AWAY)
    if run := KEEP(light=light, depth=depth, normal=normal, reset=reset, motion=motion):
        return run(light, depth, normal, reset, motion)
    halves = torch.cat([light, depth, normal, reset, motion], dim=1).bfloat16()
    return torch.stack([halves[:, 0::2], halves[:, 1::2]], dim=-1).view(torch.int32)[..., 0]


def motion_of(kept: Tensor) -> Tensor:
    """The motion of a kept frame, `[B, 2, H, W]` (x, y) in pixels."""
    return _unpacked(kept)[:, -2:]


def _unpacked(kept: Tensor) -> Tensor:
    return kept[..., None].contiguous().view(torch.bfloat16).movedim(-1, 2).flatten(1, 2).float()


def unchanged(difference: Tensor) -> Tensor:
    """The second factor of w_j, `[B, 1, H, W]`, from the differences `[B, 3, H, W]`: 0 on other surfaces."""
    H, W = difference.shape[2:]
    padded = F.pad(difference, (0, -W % RECALL_CELL, 0, -H % RECALL_CELL))
    terms = torch.cat([padded, padded.square().sum(1, keepdim=True)], dim=1)
    sums = F.avg_pool2d(F.avg_pool2d(terms, RECALL_CELL), 3, stride=1, padding=1) * (9 * RECALL_CELL**2)
    q = sums[:, :3].square().sum(1, keepdim=True) / sums[:, 3:].clamp(min=1e-30)
    weight = ((RECALL_CHANGED - q) / (RECALL_CHANGED - RECALL_ALIKE)).clamp(0, 1)
    return F.interpolate(weight, scale_factor=RECALL_CELL, mode="nearest")[:, :, :H, :W]
