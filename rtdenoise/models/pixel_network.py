"""The network of `hybrid` that writes pixels, and those that filter albedo and normal before it.

They are those of Open Image Denoise (Áfra 2019-2025, Apache License 2.0), with its weights.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import islice

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..color import srgb_decode, srgb_encode
from ..constants import PIXELS_LIGHT, PIXELS_UNIT
from ..ops.around import expand_within
from ..ops.features import features, filled
from ..ops.lift import lift, lower
from ..ops.max_pool import max_pool
from ..ops.pixels import within
from ..ops.to_planes import to_planes
from .hybrid_config import HybridConfig, PixelShape
from .inference import as_weights
from .unet import ConvRelu, Up

FADED = 3.0  # times the greatest light that a network writes: from there on another picture shows alone


class PixelUNet(nn.Module):
    """A U-Net from a picture to another of its size."""

    def __init__(self, shape: PixelShape) -> None:
        super().__init__()
        self.stages = shape.stages
        self.encoder = nn.ModuleList(ConvRelu(a, b, 3, padding=1) for a, b in shape.convolutions)
        self.decoder = nn.ModuleList(Up(*level) for level in shape.levels)
        self.last = nn.Conv2d(shape.out[0], 3, 3, padding=1)

    def filtered(self, x: Tensor) -> Tensor:
        """As `filter`, of any layout and dtype, without the zeros that fill the lanes of the first convolution."""
        return self.filter(filled(as_weights(x, self), self.encoder[0].lanes))

    def filter(self, x: Tensor) -> Tensor:
        """`[B, inputs, H, W]`, as the first convolution reads it, to `[B, 3, H, W]` in float32."""
        H, W = x.shape[2:]
        cell = 2 ** len(self.decoder)
        if H % cell or W % cell:  # by nothing, as OIDN does: the last row, repeated, would look like stripes of light
            x = F.pad(x, (0, -W % cell, 0, -H % cell))
        skips, layers = [], iter(self.encoder)
        for level, count in enumerate(self.stages):
            x = max_pool(x) if level else x
            skips.append(x)
            for convolve in islice(layers, count):
                x = convolve(x)
        for level in reversed(range(len(self.decoder))):
            x = self.decoder[level](x, skips[level])
        return to_planes(x, self.last.weight, self.last.bias)[..., :H, :W]


class PixelNetwork(PixelUNet):
    """From a picture's light and surfaces to its light without noise. The networks that filter albedo and normal before
    it get no gradient: training leaves them as they are."""

    greatest = math.inf  # light, in units of a frame's brightness, that it can write

    def __init__(self, config: HybridConfig) -> None:
        super().__init__(config.pixels)
        self.surfaces = nn.ModuleDict({name: PixelUNet(shape) for name, shape in config.surfaces.items()})

    def forward(self, lit: Tensor, albedo: Tensor, normal: Tensor) -> Tensor:
        """What each pixel showed, `[B, 3, H, W]` each, its light lifted (`written`), to the picture's light as
        `color.compress` makes it, `[B, 3, H, W]` ≥ 0 in float32."""
        if self.surfaces:
            albedo, normal = self.clean(albedo, normal)
        return self.write(lit, albedo, normal)

    def write(self, lit: Tensor, albedo: Tensor, normal: Tensor) -> Tensor:
        """As `forward`, of albedo and normal as its network of light expects them: clean, if others clean them."""
        return F.relu(self.filter(self.input(lit, albedo, normal))) / PIXELS_UNIT

    @torch.no_grad()
    def clean(self, albedo: Tensor, normal: Tensor) -> tuple[Tensor, Tensor]:
        """Both without noise, each filtered by itself; no gradients."""
        colours, directions = self.surfaces["albedo"], self.surfaces["normal"]
        albedo = srgb_decode(colours.filtered(srgb_encode(albedo.clamp(0, 1))).clamp(0, 1))
        return albedo, 2 * directions.filtered(as_color(normal)).clamp(0, 1) - 1

    @torch.no_grad()
    def input(self, lit: Tensor, albedo: Tensor, normal: Tensor) -> Tensor:
        """`features`, `[B, 9, H, W]`, with light in OIDN's unit, and albedo and normal in [0, 1]."""
        guides, lanes = (albedo.clamp(0, 1), as_color(normal)), self.encoder[0].lanes
        return features((lit,), guides, lit.new_ones(len(lit), 1, 1, 1), self.last.weight, PIXELS_UNIT, lanes)


def written(
    write: Callable[[Tensor], Tensor], radiance: Tensor, other: Tensor, exposure: Tensor, greatest: float = math.inf
) -> Tensor:
    """The light that a network makes of `radiance`, `[B, 3, H, W]`, between the least and the greatest of it and of
    the picture `other` around each pixel. `write` takes that light on OIDN's curve (`ops.lift`), and returns what
    `PixelNetwork` does. Where `other` is brighter than `greatest`, in units of a frame's brightness, it shows more and
    more, and alone from `FADED` times that on."""
    scale = PIXELS_LIGHT * exposure
    lit = lift(scale * radiance)
    around = lit if other is radiance else lift(scale * other)
    light = lower(expand_within(write(lit), lit, around)) / scale
    if math.isinf(greatest) or within(other, 0.0, (greatest / exposure).min().item()):
        return light
    beyond = (exposure * other / greatest).clamp(1, FADED).log() / math.log(FADED)
    return torch.lerp(light, other, beyond)


def as_color(normal: Tensor) -> Tensor:
    """Normals from [-1, 1] to [0, 1], as these networks know them: beyond the picture there is 0, not a normal's 0."""
    return (0.5 * normal + 0.5).clamp(0, 1)
