"""Look up an image where the motion vectors point: bilinear or cubic (`warp`, for radiance) or nearest (`fetch`, for
everything that must not be mixed across silhouettes: motion, depth, normals, ids)."""

from __future__ import annotations

import torch
from torch import Tensor

from .path import fused


def warp(
    image: Tensor,  # [B, C, H, W]
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels
    seen: Tensor | None = None,  # [B, 1, H, W] bool: where this is wanted
    otherwise: Tensor | None = None,  # [B, C, H, W] what is taken elsewhere; goes with `seen`
    cubic: bool = False,
) -> Tensor:  # [B, C, H, W]
    """Reprojection (the paper's eq. 3): `out(p) = image(p + motion(p))`, bilinear or cubic.

    With u = clamp(x + motion_x, 0, W-1), x0 = ⌊u⌋, x1 = min(x0 + 1, W-1), f = u - x0, and v, y0, y1, g alike for y:

        out[b,c,y,x] = (1-g)·((1-f)·image[b,c,y0,x0] + f·image[b,c,y0,x1])
                     +    g ·((1-f)·image[b,c,y1,x0] + f·image[b,c,y1,x1])

    What is looked up again and again, frame after frame, gets blurred by that. `cubic` takes 4×4 pixels with
    Catmull-Rom's weights along either axis,

        f·(f·(1 - f/2) - 1/2),  1 + f²·(3f/2 - 5/2),  f·(1/2 + f·(2 - 3f/2)),  f²·(f - 1)/2     at x0 - 1 ... x0 + 2,

    and holds the result between the least and the greatest of the 2×2 around u, v: it overshoots nowhere.

    Targets off the screen take the nearest border pixel (`motion.on_screen` says which they are); a motion that is not
    finite counts as zero. Whole-pixel motion, zero included, is exact to the bit, so a static picture does not drift.
    Differentiable in `image` and, almost everywhere, in `motion`.

    Raises ValueError where the shapes do not fit.
    """
    check(image, motion)
    choice = () if seen is None else (seen, otherwise)
    if run := fused("warp", image, motion, *choice[1:]):
        return run(image, motion, *choice, cubic=cubic)
    B, C, H, W = image.shape
    u, v = _targets(motion, H, W)
    columns, rows = _taps(u, W, cubic, image.dtype), _taps(v, H, cubic, image.dtype)
    flat = image.reshape(B, C, H * W)

    def at(y: Tensor, x: Tensor) -> Tensor:
        index = (y * W + x).reshape(B, 1, H * W).expand(B, C, H * W)
        return flat.gather(2, index).reshape(B, C, H, W)

    taps = [[at(y, x) for x, _ in columns] for y, _ in rows]
    lines = (sum(tap * weight for tap, (_, weight) in zip(line, columns, strict=True)) for line in taps)
    found = sum(line * weight for line, (_, weight) in zip(lines, rows, strict=True))
    if cubic:
        around = torch.stack([tap for line in taps[1:3] for tap in line[1:3]])
        found = torch.minimum(torch.maximum(found, around.amin(0)), around.amax(0))
    return found if seen is None else torch.where(seen, found, otherwise)


def _taps(u: Tensor, n: int, cubic: bool, dtype: torch.dtype) -> list[tuple[Tensor, Tensor]]:
    """Along one axis, of n pixels: which are looked up `[B, H, W]` for targets u, and their weights `[B, 1, H, W]`."""
    first = u.floor()
    f = u - first
    if cubic:
        weights = (
            f * (f * (1 - 0.5 * f) - 0.5), 1 + f * f * (1.5 * f - 2.5), f * (0.5 + f * (2 - 1.5 * f)),
            f * f * (0.5 * f - 0.5),
        )  # fmt: skip
    else:
        weights = (1 - f, f)
    before = 1 if cubic else 0
    places = ((first.long() + i - before).clamp(0, n - 1) for i in range(len(weights)))
    return [(place, weight.unsqueeze(1).to(dtype)) for place, weight in zip(places, weights, strict=True)]


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
