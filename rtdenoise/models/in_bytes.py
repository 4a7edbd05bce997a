"""Networks in bytes: less time than in bfloat16 on CPUs that multiply bytes.

In bytes are the U-Net that predicts kernels (`accumulated_kpn`), the network of `hybrid` that writes pixels, and those
that filter albedo and normal before it. Weights are whole numbers from -127 to 127 with a factor for each output,
features whole numbers from 0 to 255 with a step for each channel; sums are exact (docs/notes/bytes.md).
`tools/weights_in_bytes.py` finds the steps.

Most weights are rounded to the nearest. Where that would be seen in pixels, they were rounded one by one, each so that
it makes up for the errors of those before, for what a layer sees in some frames (Frantar et al. 2023, *GPTQ*).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..ops.convolve_bytes import QUAD, convolve_bytes, packed
from ..ops.feature_bytes import SURFACE, feature_bytes
from ..ops.features import filled
from ..ops.to_bytes import to_bytes
from .bytes_layout import INPUT, PIXELS, UNET, Layer, Picture, layout
from .config import AccumulatedKPNConfig
from .fused_layers import enlarging
from .hybrid_config import HybridConfig
from .pixel_network import PixelNetwork, PixelUNet
from .unet import UNet

WHOLE = 127  # the greatest weight

Stored = dict[str, dict[str, Tensor]]  # layer -> its tensors, as `bytes_layout.read` returns them


class UNetInBytes(UNet):
    """A `UNet` without gradients. Its input and its results are numbers as before."""

    def __init__(self, network: UNet, stored: Stored, config: AccumulatedKPNConfig) -> None:
        nn.Module.__init__(self)
        made = _convolutions(network, UNET, layout(config), stored)
        self.encoder = nn.ModuleList(
            nn.Sequential(made[f"encoder.{i}.0"], made[f"encoder.{i}.2"]) for i in range(len(network.encoder))
        )
        self.encoder[0].insert(0, ToBytes(stored[f"{UNET}.{INPUT}"]["step"]))
        self.decoder = _decoder(network, made)
        for i in range(1, len(network.decoder)):
            self.register_buffer(f"step{i}", stored[f"{UNET}.decoder.{i}.2"]["step"].view(-1, 1, 1), persistent=False)

    def forward(self, x: Tensor, scales: int) -> list[Tensor]:
        """As `UNet.forward`."""
        finest, *coarser = super().forward(x, scales)
        numbers = (y.to(x.dtype) * self.get_buffer(f"step{i}").to(x.dtype) for i, y in enumerate(coarser, start=1))
        return [finest.to(x.dtype), *numbers]


class PixelUNetInBytes(PixelUNet):
    """A `PixelUNet` without gradients."""

    def __init__(self, network: PixelUNet, prefix: str, layers: dict[str, Layer], stored: Stored) -> None:
        nn.Module.__init__(self)
        made = _convolutions(network, prefix, layers, stored)
        self.stages, self.last = network.stages, network.last
        self.encoder = nn.ModuleList(made[f"encoder.{i}"] for i in range(len(network.encoder)))
        self.decoder = _decoder(network, made)

    def filtered(self, x: Tensor) -> Tensor:
        """As that of `PixelUNet`, of `x` in [0, 1]."""
        x = (x * SURFACE).round().to(torch.uint8, memory_format=torch.channels_last)
        return self.filter(filled(x, QUAD))


class PixelNetworkInBytes(PixelUNetInBytes, PixelNetwork):
    """A `PixelNetwork` without gradients."""

    greatest = 1500.0  # bytes end where features of the brightest calibration frames did: some 5000

    def __init__(self, network: PixelNetwork, stored: Stored, config: HybridConfig) -> None:
        layers = layout(config)
        super().__init__(network, PIXELS, layers, stored)
        self.surfaces = nn.ModuleDict({
            name: PixelUNetInBytes(surface, f"{PIXELS}.surfaces.{name}", layers, stored)
            for name, surface in network.surfaces.items()
        })  # fmt: skip

    def input(self, lit: Tensor, albedo: Tensor, normal: Tensor) -> Tensor:
        """As that of `PixelNetwork`, in bytes."""
        return feature_bytes(lit, albedo, normal)


def _convolutions(network: nn.Module, prefix: str, layers: dict[str, Layer], stored: Stored) -> dict[str, Convolution]:
    """Name in `network` -> convolution, for those of the `layers` that are of its encoder and decoder."""

    def step(picture: Picture) -> Tensor:
        if picture.maker in stored:
            return stored[picture.maker]["step"]
        return torch.full((picture.channels,), 1 / SURFACE, dtype=torch.float32)  # albedo or normal

    made = {}
    for name, layer in layers.items():
        if not name.startswith((f"{prefix}.encoder.", f"{prefix}.decoder.")):
            continue
        inner, found = name.removeprefix(f"{prefix}."), stored.get(name, {})
        if layer.careful:
            found = {part: found[part] for part in ("weight", "factor", "bias")}
        else:
            of_result = torch.ones(layer.outputs, dtype=torch.float32) if layer.numbers else found["step"]
            found = rounded(network.get_submodule(inner), [step(picture) for picture in layer.reads], of_result)
        made[inner] = Convolution(**found, numbers=layer.numbers)
    return made


def _decoder(network: nn.Module, made: dict[str, Convolution]) -> nn.ModuleList:
    return nn.ModuleList(Up(made[f"decoder.{i}.0"], made[f"decoder.{i}.2"]) for i in range(len(network.decoder)))


class ToBytes(nn.Module):
    """Numbers ≥ 0 in bytes, with a step for each channel."""

    def __init__(self, step: Tensor) -> None:
        super().__init__()
        self.register_buffer("scale", 1 / step.view(-1, 1, 1), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        return to_bytes(x, self.scale.to(x.dtype))


class Convolution(nn.Module):
    """`convolve_bytes` with its weights; to numbers in bfloat16, or to bytes."""

    def __init__(self, weight: Tensor, factor: Tensor, bias: Tensor, numbers: bool = False) -> None:
        super().__init__()
        for name, tensor in {"weight": weight, "factor": factor, "bias": bias}.items():
            self.register_buffer(name, tensor, persistent=False)
        self.dtype = torch.bfloat16 if numbers else torch.uint8

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Convolution:
        """Of what `to` does: another device alone. Weights keep their type and layout."""
        kept = dict(self.named_buffers())
        super()._apply(fn, recurse)
        for name, tensor in kept.items():
            setattr(self, name, tensor.to(getattr(self, name).device))
        return self

    def forward(self, x: Tensor, below: Tensor | None = None) -> Tensor:
        x = x.contiguous(memory_format=torch.channels_last)
        return convolve_bytes(x, self.weight, self.factor, self.bias, below, self.dtype)


class Up(nn.Module):
    """As `unet.Up`."""

    def __init__(self, first: Convolution, second: Convolution) -> None:
        super().__init__()
        self.first, self.second = first, second

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        return self.second(self.first(skip, below=x))


def rounded(layer: nn.Conv2d, steps: Sequence[Tensor], made: Tensor) -> dict[str, Tensor]:
    """`weight`, `factor` and `bias` of `convolve_bytes`: each weight rounded to the nearest.

    `steps`, `[C]` each, are those of the pictures that it reads, the coarser one first; `made`, `[O]`, that of its
    results. The last picture may have more channels than the layer reads.
    """
    weights, factors, channels = [], [], [len(step) for step in steps]
    weight = F.pad(layer.weight, (0, 0, 0, 0, 0, sum(channels) - layer.weight.shape[1]))
    for parts in phases(weight, channels):
        parts = [part * step.view(-1, 1, 1) for part, step in zip(parts, steps, strict=True)]
        unit = torch.cat([part.flatten(1) for part in parts], dim=1).abs().amax(1).clamp(min=1e-12) / WHOLE
        weights.append(packed([(part / unit.view(-1, 1, 1, 1)).round().to(torch.int8) for part in parts]))
        factors.append(unit / made)
    bias = (layer.bias / made).expand(len(factors), -1).contiguous()
    return {"weight": torch.stack(weights), "factor": torch.stack(factors), "bias": bias}


def phases(weight: Tensor, channels: Sequence[int]) -> list[list[Tensor]]:
    """Weights `[O, C, 3, 3]` of pictures with so many `channels` to those of each phase of `convolve_bytes`: of the
    coarser picture, if there are two, `[O, C, 2, 2]`, and of the other one `[O, C, 3, 3]`. Pixel i of the coarser
    picture reaches pixel 2i + t - 1 by tap t of `enlarging`."""
    *coarser, beside = weight.split(list(channels), dim=1)
    if not coarser:
        return [[beside]]
    taps = enlarging(coarser[0]).transpose(0, 1)
    return [[taps[:, :, [3 - a, 1 - a]][..., [3 - b, 1 - b]], beside] for a in (0, 1) for b in (0, 1)]
