"""Fireflies: single pixels that are brighter than all around them, though nothing but noise makes them so."""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import FIREFLY_ALIKE
from .alike import alike
from .dispatch import ON_STACK, Fused, Support, falls_back

IMAGES = {"light": (3,), "depth": (1,), "normal": (3,), "known": (1,)}
FUSED = Fused("fireflies.without_fireflies", native=Support(max_width=ON_STACK, channels=IMAGES),
              triton=Support(channels=IMAGES))  # fmt: skip
EIGHT = 0, 1, 2, 3, 5, 6, 7, 8  # of the 3×3 pixels around one, without itself


@falls_back
def without_fireflies(
    light: Tensor,  # [B, 3, H, W] a denoised picture
    depth: Tensor,  # [B, 1, H, W] of the frame, 0 where nothing was hit
    normal: Tensor,  # [B, 3, H, W]
    known: Tensor,  # [B, 1, H, W] in [0, 1]: how far frames before have shown this light
) -> Tensor:  # [B, 3, H, W]
    """The picture, in which a pixel that frames before do not know is no brighter than the second brightest of the
    eight around it, channel by channel:

        lerp(min(light, second), light, known)

    Networks take a lone bright sample for a detail, and keep it. A detail shows in the surfaces, too, or stays: pixels
    are as they are where fewer than FIREFLY_ALIKE of the eight may show the same surface (`alike`), where nothing was
    hit, and along the border.

    Raises ValueError where the shapes do not fit. No gradients in depth and normal.
    """
    B, C, H, W = light.shape
    given, expected = (depth.shape, normal.shape, known.shape), ((B, 1, H, W), (B, 3, H, W), (B, 1, H, W))
    if C != 3 or given != expected:
        raise ValueError(f"expected light [B, 3, H, W], depth, normal and known to fit, got {tuple(light.shape)}, "
                         f"{', '.join(str(tuple(shape)) for shape in given)}")  # fmt: skip
    if min(H, W) < 3:
        return light
    if run := FUSED(light=light, depth=depth, normal=normal, known=known):
        return run(light, depth, normal, known)
    surface = _inner(depth), _inner(normal)
    same = sum(alike(surface, other).to(light.dtype) for other in zip(_around(depth), _around(normal), strict=True))
    second = torch.stack(_around(light)).topk(2, dim=0).values[1]
    inner = _inner(light)
    less = torch.lerp(torch.minimum(inner, second), inner, _inner(known))
    out = light.clone()
    out[..., 1:-1, 1:-1] = torch.where((same >= FIREFLY_ALIKE) & (surface[0] > 0), less, inner)
    return out


def _inner(x: Tensor) -> Tensor:
    """All but the border."""
    return x[..., 1:-1, 1:-1]


def _around(x: Tensor) -> list[Tensor]:
    """The pixels beside those that `_inner` has, of each of the eight directions."""
    H, W = x.shape[2:]
    return [x[..., k // 3 : k // 3 + H - 2, k % 3 : k % 3 + W - 2] for k in EIGHT]
