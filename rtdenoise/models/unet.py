"""A compact U-Net whose decoder hands out its features at the finest scales."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..ops.max_pool import max_pool
from .config import Head


def by_name(outputs: Tensor, heads: Iterable[Head]) -> dict[str, Tensor]:
    """Split the output channels of a scale into its heads."""
    heads = tuple(heads)
    parts = outputs.split([head.channels for head in heads], dim=1)
    return {head.name: part for head, part in zip(heads, parts, strict=True)}


class ConvRelu(nn.Conv2d):
    """A convolution with its ReLU."""

    lanes = 1  # its input may have zeros for channels up to a multiple of this

    def forward(self, x: Tensor) -> Tensor:
        return F.relu(super().forward(x))


class UNet(nn.Module):
    """Encoder-decoder with skip connections (Ronneberger et al. 2015): two 3×3 convolutions a level, max pooling down,
    nearest up.

    `widths[l]` channels at 1/2^l of the input size. Any size goes in: the image is padded to whole cells of the
    coarsest level by repeating its border, and the padding is cropped away on every scale.
    """

    def __init__(self, inputs: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        self.encoder = nn.ModuleList(
            nn.Sequential(*double(a, b)) for a, b in zip((inputs, *widths), widths, strict=False)
        )
        self.decoder = nn.ModuleList(Up(a, b) for a, b in zip(widths[1:], widths, strict=False))

    def forward(self, x: Tensor, scales: int) -> list[Tensor]:
        """`[B, inputs, H, W]` to decoder features of the `scales` finest levels, finest first: `[B, widths[l],
        ⌈H/2^l⌉, ⌈W/2^l⌉]`."""
        H, W = x.shape[2:]
        cell = 2 ** (len(self.encoder) - 1)
        if H % cell or W % cell:  # F.pad would copy even if it adds nothing
            x = widened(x, -H % cell, -W % cell)

        skips = []
        for level, convolve in enumerate(self.encoder):
            x = convolve(max_pool(x) if level else x)
            skips.append(x)

        features = []
        for level in reversed(range(len(self.decoder))):
            x = self.decoder[level](x, skips[level])
            if level < scales:
                features.append(x[:, :, : -(-H // 2**level), : -(-W // 2**level)])
        return features[::-1]


class HeadsByCells(nn.ConvTranspose2d):
    """Heads at twice the size of the features, of `sizes` channels each: a transposed convolution whose stride is its
    size is a 1×1 convolution for each of the four pixels of a cell."""

    def __init__(self, inputs: int, sizes: list[int]) -> None:
        super().__init__(inputs, sum(sizes), 2, stride=2)
        self.sizes = sizes

    def forward(self, x: Tensor) -> list[Tensor]:
        """`[B, inputs, h, w]` to logits by cells, `[B, 2, 2, size, h, w]` each (`ops.apply_kernel`). One convolution a
        head keeps the channels that are used together next to each other in memory."""
        parts = (F.conv2d(x, weight, bias) for weight, bias in self.pointwise())
        return [part.unflatten(1, (2, 2, size)) for part, size in zip(parts, self.sizes, strict=True)]

    def pointwise(self) -> list[tuple[Tensor, Tensor]]:
        """Weights `[4 · size, inputs, 1, 1]` and bias of the 1×1 convolution of each head."""
        parts = zip(self.weight.split(self.sizes, dim=1), self.bias.split(self.sizes), strict=True)
        return [(w.permute(2, 3, 1, 0).reshape(-1, self.in_channels, 1, 1), b.repeat(4)) for w, b in parts]


def widened(x: Tensor, down: int, right: int) -> Tensor:
    """`x` with its last row and column repeated so many times."""
    if x.device.type == "cpu" or x.requires_grad:
        return F.pad(x, (0, right, 0, down), mode="replicate")
    return widened_in_layout(x, down, right)


def widened_in_layout(x: Tensor, down: int, right: int) -> Tensor:
    """`widened` in the layout of `x`, without gradients: on CUDA `F.pad` would leave channels last, and the next
    convolution would copy its result once more."""
    B, C, H, W = x.shape
    last = x.is_contiguous(memory_format=torch.channels_last)
    layout = torch.channels_last if last else torch.contiguous_format
    out = torch.empty((B, C, H + down, W + right), dtype=x.dtype, device=x.device, memory_format=layout)
    out[:, :, :H, :W] = x
    out[:, :, H:, :W] = x[:, :, -1:]
    out[..., W:] = out[..., W - 1 : W]
    return out


def double(inputs: int, outputs: int, last: int | None = None) -> list[nn.Module]:
    """Two 3×3 convolutions with their ReLU; the second has `last` channels, or `outputs`."""
    return [
        nn.Conv2d(inputs, outputs, 3, padding=1), nn.ReLU(inplace=True),
        nn.Conv2d(outputs, last or outputs, 3, padding=1), nn.ReLU(inplace=True),
    ]  # fmt: skip


class Up(nn.Sequential):
    """One level of the decoder: enlarge the coarser level, join the skip connection, convolve twice."""

    def __init__(self, below: int, outputs: int, skip: int | None = None, last: int | None = None) -> None:
        """`skip` channels of the skip connection and `last` of the output, where these are not `outputs`."""
        super().__init__(*double(below + (skip or outputs), outputs, last))
        self.below = below

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """`[B, below, H/2, W/2]` and `[B, outputs, H, W]` to `[B, outputs, H, W]`."""
        return super().forward(torch.cat([F.interpolate(x, scale_factor=2, mode="nearest"), skip], dim=1))
