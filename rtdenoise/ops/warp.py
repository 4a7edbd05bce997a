"""Bilinear or cubic reprojection, for radiance and other layers that may be interpolated."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from .dispatch import Fused, Support, falls_back, plain, transformed
from .targets import check, clamped_targets

MAX_CHANNELS = 8  # of the fused ops, which hold all channels of a pixel; wider images take torch's own lookup
FUSED = Fused(
    "warp", native=Support(max_channels=MAX_CHANNELS, gradients=("image",)), triton=Support(max_channels=MAX_CHANNELS)
)


@falls_back
def warp(
    image: Tensor,  # [B, C, H, W]
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels
    seen: Tensor | None = None,  # [B, 1, H, W] bool: pixels that are looked up
    otherwise: Tensor | None = None,  # [B, C, H, W] the values of all other pixels; goes with `seen`
    cubic: bool = False,
) -> Tensor:  # [B, C, H, W]
    """Reprojection (the paper's eq. 3): `out(p) = image(p + motion(p))`, bilinear or cubic.

    With u = clamp(x + motion_x, 0, W-1), x0 = ⌊u⌋, x1 = min(x0 + 1, W-1), f = u - x0, and v, y0, y1, g alike for y:

        out[b,c,y,x] = (1-g)·((1-f)·image[b,c,y0,x0] + f·image[b,c,y0,x1])
                     +    g ·((1-f)·image[b,c,y1,x0] + f·image[b,c,y1,x1])

    Bilinear lookups blur, and an image that is looked up frame after frame blurs more with each. `cubic` takes 4×4
    pixels with Catmull-Rom's weights along either axis,

        f·(f·(1 - f/2) - 1/2),  1 + f²·(3f/2 - 5/2),  f·(1/2 + f·(2 - 3f/2)),  f²·(f - 1)/2     at x0 - 1 ... x0 + 2,

    and clamps the result to the range of the 2×2 pixels around (u, v), so that it never overshoots.

    Targets off the screen take the nearest border pixel (`motion.on_screen` tells which these are); a motion that is
    not finite counts as zero. Whole-pixel motion, zero included, is exact to the bit, so a static picture does not
    drift; only bilinear lookups in more than `MAX_CHANNELS` channels round (about 1e-7 of the image's width in pixels).
    That holds for finite values: a tap of NaN, or of infinity at weight 0, makes NaN.
    Differentiable in `image` and, almost everywhere, in `motion`.

    Raises ValueError where the shapes do not fit, the image holds no floats, or `seen` is not bool.
    """
    if (seen is None) != (otherwise is None):
        raise ValueError("expected both of seen and otherwise, or none")
    choice = () if seen is None else (seen, otherwise)
    check(image, motion, **({"seen": (seen, 1), "otherwise": (otherwise, image.shape[1])} if choice else {}))
    if not image.is_floating_point():
        raise ValueError(f"expected an image of floats, got {image.dtype}")
    if choice and seen.dtype is not torch.bool:
        raise ValueError(f"expected seen of torch.bool, got {seen.dtype}")
    sampled = image.shape[1] > MAX_CHANNELS and image.numel() and not cubic
    if sampled and not (plain() or transformed(image, motion)):
        found = _grid_sample(image, motion)
        return found if seen is None else torch.where(seen, found, otherwise)
    if run := FUSED(image=image, motion=motion, otherwise=otherwise):
        return run(image, motion, *choice, cubic=cubic)
    B, C, H, W = image.shape
    u, v = clamped_targets(motion, H, W)
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


def _grid_sample(image: Tensor, motion: Tensor) -> Tensor:
    """Bilinear `warp` by torch's kernel, in float32 at least: coordinates need the digits."""
    H, W = image.shape[2:]
    dtype = torch.promote_types(torch.float32, image.dtype)
    u, v = clamped_targets(motion.to(dtype), H, W)
    grid = torch.stack([(2 * u + 1) / W - 1, (2 * v + 1) / H - 1], dim=-1)  # in [-1, 1]: the edges of the image
    return F.grid_sample(image.to(dtype), grid, padding_mode="border", align_corners=False).to(image.dtype)


def _taps(u: Tensor, n: int, cubic: bool, dtype: torch.dtype) -> list[tuple[Tensor, Tensor]]:
    """The taps of targets u along one axis of n pixels: (index `[B, H, W]`, weight `[B, 1, H, W]`) each."""
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
    indices = ((first.long() + i - before).clamp(0, n - 1) for i in range(len(weights)))
    return [(index, weight.unsqueeze(1).to(dtype)) for index, weight in zip(indices, weights, strict=True)]
