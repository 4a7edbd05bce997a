"""Nearest reprojection, for layers that must not be mixed across silhouettes: motion, depth, normals, ids."""

from __future__ import annotations

from torch import Tensor

from .dispatch import Fused, Support, falls_back
from .targets import check, clamped_targets

FUSED = Fused("fetch", native=Support(max_channels=8), triton=Support())


@falls_back
def fetch(
    image: Tensor,  # [B, C, H, W]
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels
) -> Tensor:  # [B, C, H, W]
    """Nearest reprojection: `out[b,c,y,x] = image[b, c, ⌊v + ½⌋, ⌊u + ½⌋]` with the clamped targets u, v of `warp`.

    Differentiable in `image` only. Raises ValueError where the shapes do not fit.
    """
    check(image, motion)
    if run := FUSED(image=image, motion=motion):
        return run(image, motion)
    B, C, H, W = image.shape
    u, v = clamped_targets(motion, H, W)
    index = (v + 0.5).floor().long() * W + (u + 0.5).floor().long()
    return image.reshape(B, C, H * W).gather(2, index.reshape(B, 1, H * W).expand(B, C, H * W)).reshape(B, C, H, W)
