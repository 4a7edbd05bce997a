"""A sky without noise stays as it is: kernels that reach across a silhouette would outline it faintly."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import SKY_BLOCK, SKY_TOLERANCE
from .dispatch import ON_STACK, Fused, Support, falls_back

IMAGES = {"image": (3,), "radiance": (3,), "depth": (1,)}
FUSED = Fused("even_sky", native=Support(max_width=ON_STACK, channels=IMAGES), triton=Support(channels=IMAGES))


@falls_back
def even_sky(
    image: Tensor,  # [B, 3, H, W] the filtered picture
    radiance: Tensor,  # [B, 3, H, W] ≥ 0, finite: the unfiltered picture
    depth: Tensor,  # [B, 1, H, W], 0 where nothing was hit
) -> Tensor:  # [B, 3, H, W]
    """`radiance` where the sky shows and is even, `image` elsewhere.

    A pixel is *open* where it and its 8 neighbours hit nothing. The sky shows where it and the 4 neighbours at its
    sides hit nothing; a pixel with a silhouette at its side may be an edge to smooth. Such a pixel with radiance x is
    even where there are open pixels in its `SKY_BLOCK`² block and the 8 blocks around it, and these are all within
    x · (1 ± `SKY_TOLERANCE`): sparse light as in fog, a gradient or a picture is not even.
    """
    if depth.device.type == "cpu" and bool((depth > 0).all()):
        return image  # on a GPU, looking would mean waiting
    H, W = depth.shape[2:]
    if run := FUSED(image=image, radiance=radiance, depth=depth):
        return run(image, radiance, depth)
    hit = (depth > 0).to(radiance.dtype)
    columns = F.max_pool2d(hit, (3, 1), stride=1, padding=(1, 0))
    opened = F.max_pool2d(columns, (1, 3), stride=1, padding=(0, 1)) == 0
    shows = columns.maximum(F.max_pool2d(hit, (1, 3), stride=1, padding=(0, 1))) == 0
    highest = _around(torch.where(opened, radiance, -torch.inf), (H, W))
    lowest = -_around(torch.where(opened, -radiance, -torch.inf), (H, W))
    margin = SKY_TOLERANCE * radiance
    even = (highest - radiance <= margin) & (radiance - lowest <= margin) & (lowest <= highest)
    return torch.where(shows & even.all(dim=1, keepdim=True), radiance, image)


def _around(image: Tensor, size: tuple[int, int]) -> Tensor:
    """The maximum over each pixel's block and the 8 blocks around it, `[B, C, H, W]`."""
    blocks = F.max_pool2d(image, SKY_BLOCK, ceil_mode=True)
    greatest = F.max_pool2d(blocks, 3, stride=1, padding=1)
    rows = greatest.repeat_interleave(SKY_BLOCK, dim=2)[:, :, : size[0]]
    return rows.repeat_interleave(SKY_BLOCK, dim=3)[..., : size[1]]
