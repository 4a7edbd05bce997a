"""`history_motion`, whose plain twin and declaration are in `rtdenoise.splat`: one pass over the motion vectors."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from .common import BLOCK, grid, place
from .targets import clamped_target, on_screen


@triton.jit
def _history_motion(motion, motion_next, shift, out, seen, uncovered, H, W, threshold, NEXT: tl.constexpr,
                    SHIFT: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane = tl.cast(H, tl.int64) * W
    at = y * W + x
    vectors = b * 2 * plane
    u = tl.load(motion + vectors + at, mask=exists, other=0.0)
    v = tl.load(motion + vectors + plane + at, mask=exists, other=0.0)
    chosen_u, chosen_v, apart = u, v, tl.zeros([BLOCK], tl.int1)
    if SHIFT:
        chosen_u += tl.load(shift + vectors + at, mask=exists, other=0.0)
        chosen_v += tl.load(shift + vectors + plane + at, mask=exists, other=0.0)
    if NEXT:
        looks_inside = exists & on_screen(u + x, v + y, H, W)
        there = (clamped_target(v, y, H) + 0.5).to(tl.int32) * W + (clamped_target(u, x, W) + 0.5).to(tl.int32)
        dual_u = tl.where(looks_inside, -tl.load(motion_next + vectors + there, mask=looks_inside, other=0.0), u)
        dual_v = tl.where(
            looks_inside, -tl.load(motion_next + vectors + plane + there, mask=looks_inside, other=0.0), v
        )
        apart = (dual_u - u) * (dual_u - u) + (dual_v - v) * (dual_v - v) > threshold * threshold
        chosen_u, chosen_v = tl.where(apart, dual_u, chosen_u), tl.where(apart, dual_v, chosen_v)
    if NEXT or SHIFT:
        tl.store(out + vectors + at, chosen_u, mask=exists)
        tl.store(out + vectors + plane + at, chosen_v, mask=exists)
    tl.store(seen + b * plane + at, on_screen(chosen_u + x, chosen_v + y, H, W).to(tl.uint8), mask=exists)
    tl.store(uncovered + b * plane + at, apart.to(tl.uint8), mask=exists)


def history_motion(
    motion: Tensor, motion_next: Tensor | None, threshold: float, shift: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Without `motion_next` no pixel is uncovered."""
    motion, (B, _, H, W) = motion.contiguous(), motion.shape
    vectors = [motion if t is None else t.contiguous() for t in (motion_next, shift)]
    given = {"NEXT": motion_next is not None, "SHIFT": shift is not None}
    out = torch.empty_like(motion) if any(given.values()) else motion
    seen, uncovered = motion.new_empty(2, B, 1, H, W, dtype=torch.uint8)
    _history_motion[grid(B, H, W)](motion, *vectors, out, seen, uncovered, H, W, threshold, **given, BLOCK=BLOCK)
    return out, seen.view(torch.bool), uncovered.view(torch.bool)
