"""A block of guided self-attention over a level of a U-Net."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..ops import attend_blocks
from .afgsa import OFFSETS
from .refinement_config import REFINED_BLOCK, REFINED_HALO, REFINED_HEADS, SURFACE, refined_shapes
from .unet import ConvRelu


class GuidedRefinement(nn.Module):
    """Adds to every cell of a level a weighted mean of the cells in the window around its block (`ops.attend_blocks`).
    The weights come from the level and from features of the surface, the averaged values from the level alone. The last
    convolution starts at 0, so a network that gets such a block computes what it computed before."""

    def __init__(self, width: int) -> None:
        super().__init__()
        shapes = refined_shapes("", width)
        self.join = ConvRelu(width + SURFACE, width, 1)
        self.query, self.key, self.value = (nn.Conv2d(width, width, 1, bias=False) for _ in range(3))
        self.rows, self.columns = (nn.Parameter(OFFSETS * torch.randn(shapes[name])) for name in ("rows", "columns"))
        self.out = nn.Conv2d(width, width, 1)

    def forward(self, level: Tensor, guide: Tensor) -> Tensor:
        """`[B, width, ⌈H/4⌉, ⌈W/4⌉]` and features of the surface `[B, 7, H, W]` to the refined level."""
        guide = F.avg_pool2d(guide.float(), 4, ceil_mode=True).to(level.dtype)
        joined = self.join(torch.cat([level, guide], dim=1))
        mean = attend_blocks(
            self.query(joined), self.key(joined), self.value(level), self.rows, self.columns, block=REFINED_BLOCK,
            halo=REFINED_HALO, heads=REFINED_HEADS,
        )  # fmt: skip
        return level + self.out(mean)
