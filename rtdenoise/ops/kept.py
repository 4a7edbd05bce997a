"""Recent frames as they are kept: two bfloat16 in a word, and the paths of pixels back through them (`ops.recall`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import (
    DEPTH_TOLERANCE,
    FAR_AWAY,
    RECALL_DEPTH,
    RECALL_EDGE_SPEED,
    RECALL_FOOTPRINT_WORDS,
    RECALL_WORDS,
)
from .fetch import fetch

CHANNELS = 3, 1, 3, 1, 2, 3, 2, 1  # of a kept frame: those of `Kept`, and nothing
BESIDE = (0, 0), (-1, 0), (0, -1), (0, 1), (1, 0)  # (y, x): a pixel and the four beside it


def check_kept(recent: Sequence[Tensor], size: tuple[int, int, int, int]) -> None:
    """Raise ValueError unless the frames are those of `keep`, `[B, words, H, W]`, or those for footprints."""
    B, words, H, W = size
    for kept in recent:
        fits = kept.shape in ((B, words, H, W), (B, RECALL_FOOTPRINT_WORDS, H, W))
        if not fits or kept.dtype != torch.int32:
            raise ValueError(f"expected kept frames of {size} int32, got {tuple(kept.shape)} {kept.dtype}")


def edge_motion(motion: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """The motion of the edge in each pixel, `[B, 2, H, W]`, and the distance of the surface that has it, `[B, 1, H,
    W]`, infinite where nothing was hit.

    It is that of the nearest of a pixel and the four beside it (each in turn is nearer by more than DEPTH_TOLERANCE or
    does not count), unless that moves against the pixel by more than RECALL_EDGE_SPEED: then it is the pixel's own."""
    H, W = depth.shape[2:]
    own = distance(depth)
    around, nearest, found = F.pad(own, (1, 1, 1, 1), mode="replicate"), own, motion
    motions = F.pad(motion, (1, 1, 1, 1), mode="replicate")
    for y, x in BESIDE[1:]:
        window = (..., slice(1 + y, 1 + y + H), slice(1 + x, 1 + x + W))
        nearer = around[window] < (1 - DEPTH_TOLERANCE) * nearest
        nearest, found = torch.where(nearer, around[window], nearest), torch.where(nearer, motions[window], found)
    slow = (found - motion).square().sum(1, keepdim=True) <= RECALL_EDGE_SPEED**2
    return torch.where(slow, found, motion), torch.where(slow, nearest, own)


def distance(depth: Tensor) -> Tensor:
    """Depth, but infinite where nothing was hit."""
    return torch.where(depth > 0, depth, torch.inf)


def motion_of(kept: Tensor) -> Tensor:
    """The motion of a kept frame, `[B, 2, H, W]` (x, y) in pixels."""
    return _unpacked(kept[:, RECALL_WORDS - 1 : RECALL_WORDS])


def nearer(depth: Tensor, by: Tensor | float) -> Tensor:
    """Depth less `by`, of what was hit; what lies behind the camera then is as near as can be."""
    return (depth - by).clamp(min=torch.finfo(depth.dtype).tiny).where(depth > 0, depth)


def kept_beside(kept: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
    """Distances, `[4, B, 1, H, W]`, and motions, `[4, B, 2, H, W]`, that a kept frame has in the four pixels beside
    that where a whole `motion` leads. Borders are repeated."""
    H, W = kept.shape[2:]
    _, depth, _, _, moves = _unpacked(kept[:, :RECALL_WORDS]).split(CHANNELS[:5], dim=1)
    padded = F.pad(torch.cat([distance(depth), moves], dim=1), (1, 1, 1, 1), mode="replicate")
    found = torch.stack([fetch(padded[..., 1 + y : 1 + y + H, 1 + x : 1 + x + W], motion) for y, x in BESIDE[1:]])
    return found[:, :, :1], found[:, :, 1:]


def kept_nearer(kept: Tensor, by: Tensor) -> Tensor:
    """A kept frame whose surfaces are nearer by so much, `[B, 1, 1, 1]`; it is copied."""
    words = kept[:, RECALL_DEPTH : RECALL_DEPTH + 1]
    depth = nearer((words & -65536).view(torch.float32), by).bfloat16().float()
    kept = kept.clone()
    kept[:, RECALL_DEPTH : RECALL_DEPTH + 1] = words & 0xFFFF | depth.view(torch.int32)
    return kept


def _unpacked(kept: Tensor) -> Tensor:
    return kept[..., None].contiguous().view(torch.bfloat16).movedim(-1, 2).flatten(1, 2).float()


@dataclass(frozen=True)
class Kept:
    """A kept frame, unpacked; the last two are None where it has none."""

    light: Tensor  # [B, 3, H, W]
    depth: Tensor  # [B, 1, H, W]
    normal: Tensor  # [B, 3, H, W]
    reset: Tensor  # [B, 1, H, W]
    motion: Tensor  # [B, 2, H, W]
    albedo: Tensor | None = None  # [B, 3, H, W]
    edge: Tensor | None = None  # [B, 2, H, W] `edge_motion`


class Path:
    """The path of each pixel back through kept frames."""

    def __init__(self, motion: Tensor) -> None:
        self.motion, self.left = motion, torch.ones_like(motion[:, :1])  # `left`: the share that resets have left

    def look(self, kept: Tensor) -> Kept:
        """What the path leads to, at the nearest pixel. Sets `whole`, the motion to that pixel, `[B, 2, H, W]`,
        `inside`, whether it is on the screen, `cover`, the share of the pixel there that the path's pixel covers, and
        `off`, the square of their distance, `[B, 1, H, W]` each."""
        B, words, H, W = kept.shape
        x = torch.arange(W, device=kept.device, dtype=self.motion.dtype)
        y = torch.arange(H, device=kept.device, dtype=self.motion.dtype)[:, None]
        motion = torch.nan_to_num(self.motion, nan=FAR_AWAY).clamp(-FAR_AWAY, FAR_AWAY)
        self.whole = whole = motion.round()
        u, v = whole[:, :1] + x, whole[:, 1:] + y
        self.inside = (u >= 0) & (u < W) & (v >= 0) & (v < H)
        self.cover = (1 - (motion - whole).abs()).prod(1, keepdim=True)
        self.off = (motion - whole).square().sum(1, keepdim=True)
        index = (v.clamp(0, H - 1).long() * W + u.clamp(0, W - 1).long()).reshape(B, 1, H * W)
        there = _unpacked(kept.flatten(2).gather(2, index.expand(B, words, -1)).unflatten(2, (H, W)))
        channels = CHANNELS[:5] if words == RECALL_WORDS else CHANNELS
        return Kept(*there.split(channels, dim=1)[:7])

    def follow(self, motion: Tensor, reset: Tensor) -> None:
        """Go on by the motion that was found there."""
        self.motion, self.left = torch.where(self.inside, self.motion + motion, FAR_AWAY), self.left * (1 - reset)
