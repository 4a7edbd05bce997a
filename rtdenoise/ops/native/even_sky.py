"""`even_sky`, in two passes: the sky in blocks, then the pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ...constants import SKY_BLOCK, SKY_TOLERANCE
from .compiler import library, pointer


def even_sky(image: Tensor, radiance: Tensor, depth: Tensor) -> Tensor:
    image, radiance, depth = image.contiguous(), radiance.contiguous(), depth.contiguous()
    B, _, H, W = image.shape
    opened = image.new_empty(B, H, W, dtype=torch.uint8)
    lowest, highest = image.new_empty(2, B, 3, -(-H // SKY_BLOCK), -(-W // SKY_BLOCK))
    out, sizes = torch.empty_like(image), (B, H, W, torch.get_num_threads())
    code = library("even_sky", BLOCK=SKY_BLOCK, TOLERANCE=SKY_TOLERANCE)
    code.sky_blocks(*map(pointer, (radiance, depth, opened, lowest, highest)), *sizes)
    code.even_sky(*map(pointer, (image, radiance, opened, lowest, highest, out)), *sizes)
    return out
