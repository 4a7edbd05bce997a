"""Bilinear reprojection that tests every tap: history only where it shows the same surface."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import torch
from torch import Tensor

from ..constants import DEPTH_TOLERANCE, FAR_AWAY, MIN_HISTORY_WEIGHT, MIN_NORMAL_COSINE
from .alike import alike
from .dispatch import Fused, Support, falls_back
from .targets import check

FUSED = Fused("reproject", native=Support(max_channels=8, gradients=("stored",)), triton=Support())


@falls_back
def reproject(
    stored: Tensor | Sequence[Tensor],  # [B, C, H, W] of the previous frame; several are joined along channels
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels
    surface: tuple[Tensor, Tensor],  # depth [B, 1, H, W] and normal [B, 3, H, W] of the current frame
    surface_previous: tuple[Tensor, Tensor],  # the same of the previous frame, not reprojected
    depth_tolerance: float = DEPTH_TOLERANCE,
    normal_tolerance: float = MIN_NORMAL_COSINE,
) -> tuple[Tensor, Tensor]:  # [B, C, H, W], [B, 1, H, W] bool
    """`warp` without taps from other surfaces or from off the screen; the second result is False where no tap is left.

        out(p) = Σ_t b_t v_t stored(t) / Σ_t b_t v_t          over the four pixels t around p + motion(p)

    with the bilinear weights b_t, and v_t = 1 where t is on the screen and its surface is `alike` the one at p. Where
    Σ b v < `MIN_HISTORY_WEIGHT` the result is 0 and not valid. So history neither leaks across silhouettes nor fades at
    them. A tap without weight is not read: NaN and infinite values, as the depth of a miss, do not leak either.
    Differentiable in `stored`.

    Raises ValueError where the shapes do not fit, or nothing is stored.
    """
    stored = [stored] if isinstance(stored, Tensor) else [*stored]
    (depth, normal), (depth_before, normal_before) = surface, surface_previous
    if not stored:
        raise ValueError("expected an image to look up, or several, got none")
    for image in stored:
        check(image, motion, depth=(depth, 1), normal=(normal, 3),
              depth_previous=(depth_before, 1), normal_previous=(normal_before, 3))  # fmt: skip
    if run := FUSED(stored=stored, motion=motion, surface=surface, surface_previous=surface_previous):
        return run(stored, motion, *surface, *surface_previous, tolerances=(depth_tolerance, normal_tolerance))
    stored = torch.cat(stored, dim=1)
    B, C, H, W = stored.shape
    motion = motion.to(torch.promote_types(motion.dtype, torch.float32))
    x = torch.arange(W, device=motion.device, dtype=motion.dtype)
    y = torch.arange(H, device=motion.device, dtype=motion.dtype)[:, None]
    motion = torch.nan_to_num(motion, nan=FAR_AWAY, posinf=FAR_AWAY, neginf=-FAR_AWAY).clamp(-FAR_AWAY, FAR_AWAY)
    u, v = motion[:, 0] + x, motion[:, 1] + y
    left, top = u.floor(), v.floor()
    f, g = u - left, v - top
    left, top = left.long(), top.long()

    geometry = torch.cat(surface_previous, dim=1).reshape(B, 4, H * W)
    flat = stored.reshape(B, C, H * W)
    total, found = torch.zeros_like(surface[0]), torch.zeros_like(stored)
    for dy, dx in product((0, 1), repeat=2):
        i, j = top + dy, left + dx
        inside = (i >= 0) & (i < H) & (j >= 0) & (j < W)
        index = (i.clamp(0, H - 1) * W + j.clamp(0, W - 1)).reshape(B, 1, H * W)
        before = geometry.gather(2, index.expand(B, 4, H * W)).reshape(B, 4, H, W)
        same = alike(surface, (before[:, :1], before[:, 1:]), depth_tolerance, normal_tolerance) & inside.unsqueeze(1)
        weight = ((f if dx else 1 - f) * (g if dy else 1 - g)).unsqueeze(1) * same
        total = total + weight
        there = flat.gather(2, index.expand(B, C, H * W)).reshape(B, C, H, W)
        found = found + weight * there.where(weight > 0, 0.0)
    valid = total >= MIN_HISTORY_WEIGHT
    return torch.where(valid, found / total.clamp(min=MIN_HISTORY_WEIGHT), 0.0), valid
