"""Look up an image where the motion vectors point: bilinear (`warp`, for radiance) or nearest (`fetch`, for everything
that must not be mixed across silhouettes: motion, depth, normals, ids)."""

from __future__ import annotations

import torch
from torch import Tensor

from .path import fused


def warp(
    image: Tensor,  # [B, C, H, W]
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels
    seen: Tensor | None = None,  # [B, 1, H, W] bool: where this is wanted
    otherwise: Tensor | None = None,  # [B, C, H, W] what is taken elsewhere; goes with `seen`
) -> Tensor:  # [B, C, H, W]
    """Bilinear reprojection (the paper's eq. 3): `out(p) = image(p + motion(p))`.

    With u = clamp(x + motion_x, 0, W-1), x0 = ⌊u⌋, x1 = min(x0 + 1, W-1), f = u - x0, and v, y0, y1, g alike for y:

        out[b,c,y,x] = (1-g)·((1-f)·image[b,c,y0,x0] + f·image[b,c,y0,x1])
                     +    g ·((1-f)·image[b,c,y1,x0] + f·image[b,c,y1,x1])

    Targets off the screen take the nearest border pixel (`motion.on_screen` says which they are); a motion that is not
    finite counts as zero. Whole-pixel motion, zero included, is exact to the bit, so a static picture does not drift.
    Differentiable in `image` and, almost everywhere, in `motion`.

    Raises ValueError where the shapes do not fit.
    """
    check(image, motion)
    choice = () if seen is None else (seen, otherwise)
    if run := fused("warp", image, motion, *choice[1:]):
        return run(image, motion, *choice)
    B, C, H, W = image.shape
    u, v = _targets(motion, H, W)
    x0, y0 = u.floor(), v.floor()
    f, g = (u - x0).unsqueeze(1).to(image.dtype), (v - y0).unsqueeze(1).to(image.dtype)
    x0, y0 = x0.long(), y0.long()
    x1, y1 = (x0 + 1).clamp(max=W - 1), (y0 + 1).clamp(max=H - 1)

    flat = image.reshape(B, C, H * W)

    def at(y: Tensor, x: Tensor) -> Tensor:
        index = (y * W + x).reshape(B, 1, H * W).expand(B, C, H * W)
        return flat.gather(2, index).reshape(B, C, H, W)

    top = at(y0, x0) * (1 - f) + at(y0, x1) * f
    bottom = at(y1, x0) * (1 - f) + at(y1, x1) * f
    found = top * (1 - g) + bottom * g
    return found if seen is None else torch.where(seen, found, otherwise)


def fetch(
    image: Tensor,  # [B, C, H, W]
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels
) -> Tensor:  # [B, C, H, W]
    """Nearest reprojection: `out[b,c,y,x] = image[b, c, ⌊v + ½⌋, ⌊u + ½⌋]` with the clamped targets u, v of `warp`.

    Differentiable in `image` only. Raises ValueError where the shapes do not fit.
    """
    check(image, motion)
    if run := fused("fetch", image, motion):
        return run(image, motion)
    B, C, H, W = image.shape
    u, v = _targets(motion, H, W)
    index = (v + 0.5).floor().long() * W + (u + 0.5).floor().long()
    return image.reshape(B, C, H * W).gather(2, index.reshape(B, 1, H * W).expand(B, C, H * W)).reshape(B, C, H, W)


def _targets(motion: Tensor, H: int, W: int) -> tuple[Tensor, Tensor]:
    """Clamped target coordinates u, v `[B, H, W]`, in units where pixel (0, 0) is at 0."""
    motion = torch.nan_to_num(motion, nan=0.0, posinf=0.0, neginf=0.0)
    x = torch.arange(W, device=motion.device, dtype=motion.dtype)
    y = torch.arange(H, device=motion.device, dtype=motion.dtype)
    return (motion[:, 0] + x).clamp(0, W - 1), (motion[:, 1] + y[:, None]).clamp(0, H - 1)


def check(image: Tensor, motion: Tensor) -> None:
    if image.ndim != 4:
        raise ValueError(f"expected image [B, C, H, W], got {tuple(image.shape)}")
    expected = (image.shape[0], 2, *image.shape[2:])
    if tuple(motion.shape) != expected:
        raise ValueError(f"expected motion {expected} for an image {tuple(image.shape)}, got {tuple(motion.shape)}")
