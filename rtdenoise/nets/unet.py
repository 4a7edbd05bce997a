"""A compact U-Net whose decoder hands out its features at the finest scales."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F


class UNet(nn.Module):
    """Encoder-decoder with skip connections (Ronneberger et al. 2015): two 3×3 convolutions a level, max pooling down,
    nearest up.

    `widths[l]` channels at 1/2^l of the input size. Any size goes in: the image is padded to whole cells of the
    coarsest level by repeating its border, and the padding is cropped away on every scale.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.encoder = nn.ModuleList(_double(a, b) for a, b in zip((inputs, *widths), widths, strict=False))
        self.decoder = nn.ModuleList(_double(a + b, b) for a, b in zip(widths[1:], widths, strict=False))

    def forward(self, x: Tensor, scales: int) -> list[Tensor]:
        """`[B, inputs, H, W]` to decoder features of the `scales` finest levels, finest first: `[B, widths[l],
        ⌈H/2^l⌉, ⌈W/2^l⌉]`."""
        H, W = x.shape[2:]
        cell = 2 ** (len(self.encoder) - 1)
        if H % cell or W % cell:  # a copy otherwise too
            x = F.pad(x, (0, -W % cell, 0, -H % cell), mode="replicate")

        skips = []
        for level, convolve in enumerate(self.encoder):
            x = convolve(F.max_pool2d(x, 2) if level else x)
            skips.append(x)

        features = []
        for level in reversed(range(len(self.decoder))):
            x = F.interpolate(x, scale_factor=2, mode="nearest")
            x = self.decoder[level](torch.cat([x, skips[level]], dim=1))
            if level < scales:
                features.append(x[:, :, : -(-H // 2**level), : -(-W // 2**level)])
        return features[::-1]


def _double(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1), nn.ReLU(inplace=True),
        nn.Conv2d(outputs, outputs, 3, padding=1), nn.ReLU(inplace=True),
    )  # fmt: skip
