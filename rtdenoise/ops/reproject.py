"""Look up history where it shows the same surface: bilinear reprojection whose taps are tested one by one."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import torch
from torch import Tensor

from .path import fused
from .warp import check

LEAST = 1e-2  # sum of bilinear weights that makes a history: dividing by less only brings out what was rounded


def alike(
    surface: tuple[Tensor, Tensor],  # depth [B, 1, H, W] and normal [B, 3, H, W] at each pixel
    other: tuple[Tensor, Tensor],  # ... of what it is compared with
    depth_tolerance: float = 0.1,
    normal_tolerance: float = 0.5,
) -> Tensor:  # [B, 1, H, W] bool
    """Whether two pixels may show the same surface: depths that differ by at most `depth_tolerance` (relative) and
    normals whose cosine is `normal_tolerance` at least; two misses (depth 0) are alike, a hit and a miss are not.

    Normals need not be of unit length: at edges they are means over the pixel. One of length 0 says nothing.
    """
    (depth, normal), (was_depth, was_normal) = surface, other
    near = (depth - was_depth).abs() <= depth_tolerance * torch.maximum(depth, was_depth)
    lengths = (normal.square().sum(1, keepdim=True) * was_normal.square().sum(1, keepdim=True)).sqrt()
    aligned = (normal * was_normal).sum(1, keepdim=True) >= normal_tolerance * lengths
    hit, was_hit = depth > 0, was_depth > 0
    return torch.where(hit & was_hit, near & aligned, hit == was_hit)


def reproject(
    stored: Tensor | Sequence[Tensor],  # [B, C, H, W] of the previous frame, or several, whose channels are joined
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels
    surface: tuple[Tensor, Tensor],  # depth [B, 1, H, W] and normal [B, 3, H, W] of the current frame
    surface_previous: tuple[Tensor, Tensor],  # ... of the previous one, not reprojected
    depth_tolerance: float = 0.1,
    normal_tolerance: float = 0.5,
) -> tuple[Tensor, Tensor]:  # [B, C, H, W], [B, 1, H, W] bool
    """`warp` that takes no tap from another surface or from off the screen, and says where no tap was left.

        out(p) = Σ_t b_t v_t stored(t) / Σ_t b_t v_t          over the four pixels t around p + motion(p)

    with the bilinear weights b_t, and v_t = 1 where t is on the screen and shows a surface `alike` that at p. Where
    Σ b v < 0.01 the result is 0 and the second value False. History then neither leaks across silhouettes nor fades at
    them. Differentiable in `stored`.

    Raises ValueError where the shapes do not fit.
    """
    stored = [stored] if isinstance(stored, Tensor) else [*stored]
    for image in stored:
        check(image, motion)
    if run := fused("reproject", *stored, motion, *surface, *surface_previous):
        tolerances = (depth_tolerance, normal_tolerance)
        return run(stored, motion, *surface, *surface_previous, tolerances=tolerances, least=LEAST)
    stored = torch.cat(stored, dim=1)
    B, C, H, W = stored.shape
    x = torch.arange(W, device=motion.device, dtype=motion.dtype)
    y = torch.arange(H, device=motion.device, dtype=motion.dtype)[:, None]
    # Far away is as good as off the screen, and its square pixel numbers still fit an integer.
    motion = torch.nan_to_num(motion, nan=1e6, posinf=1e6, neginf=-1e6).clamp(-1e6, 1e6)
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
        found = found + weight * flat.gather(2, index.expand(B, C, H * W)).reshape(B, C, H, W)
    valid = total >= LEAST
    return torch.where(valid, found / total.clamp(min=LEAST), 0.0), valid
