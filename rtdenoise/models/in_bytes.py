"""Networks in bytes: less time than in bfloat16 on CPUs that multiply bytes.

In bytes are the U-Net that predicts kernels (`accumulated_kpn`) and the network of `hybrid` that writes pixels. Weights
are whole numbers from -127 to 127 with a factor for each output, features whole numbers from 0 to 255 with a step for
each channel; sums are exact (docs/notes/bytes.md). `tools/weights_in_bytes.py` finds the steps.

Kernels take weights that are rounded to the nearest. The pixels' weights were rounded one by one, each so that it makes
up for the errors of those before, for what a layer sees in some frames (Frantar et al. 2023, *GPTQ*).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from ..ops.convolve_bytes import convolve_bytes, packed
from ..ops.feature_bytes import feature_bytes
from .bytes_layout import INPUT, PIXELS, UNET, Layer, layout
from .config import AccumulatedKPNConfig
from .inference import enlarging
from .pixel_network import PixelNetwork, as_color
from .unet import UNet

WHOLE = 127  # the greatest weight

Stored = dict[str, dict[str, Tensor]]  # layer -> its tensors, as `bytes_layout.read` returns them


class UNetInBytes(UNet):
    """A `UNet` without gradients. Its input and its results are numbers as before."""

    def __init__(self, network: UNet, stored: Stored, config: AccumulatedKPNConfig) -> None:
        nn.Module.__init__(self)

        def convolution(name: str, layer: Layer) -> Convolution:
            steps = [stored[picture.maker]["step"] for picture in layer.reads]
            step = stored[name]["step"]
            module = network.get_submodule(name.removeprefix(f"{UNET}."))
            made = rounded(module, steps, torch.ones_like(step) if layer.numbers else step)
            return Convolution(**made, numbers=layer.numbers)

        made = {name: convolution(name, layer) for name, layer in layout(config).items() if name.startswith(UNET)}
        self.encoder = nn.ModuleList(
            nn.Sequential(made[f"{UNET}.encoder.{i}.0"], made[f"{UNET}.encoder.{i}.2"])
            for i in range(len(network.encoder))
        )
        self.encoder[0].insert(0, ToBytes(stored[f"{UNET}.{INPUT}"]["step"]))
        self.decoder = nn.ModuleList(
            Up(made[f"{UNET}.decoder.{i}.0"], made[f"{UNET}.decoder.{i}.2"]) for i in range(len(network.decoder))
        )
        for i in range(1, len(network.decoder)):
            self.register_buffer(f"step{i}", stored[f"{UNET}.decoder.{i}.2"]["step"].view(-1, 1, 1), persistent=False)

    def forward(self, x: Tensor, scales: int) -> list[Tensor]:
        """As `UNet.forward`."""
        finest, *coarser = super().forward(x, scales)
        numbers = (y.to(x.dtype) * self.get_buffer(f"step{i}").to(x.dtype) for i, y in enumerate(coarser, start=1))
        return [finest.to(x.dtype), *numbers]


class PixelNetworkInBytes(PixelNetwork):
    """A `PixelNetwork` without gradients."""

    def __init__(self, network: PixelNetwork, stored: Stored) -> None:
        nn.Module.__init__(self)
        self.stages, self.surfaces = network.stages, network.surfaces
        self.encoder = nn.ModuleList(
            Convolution(**stored[f"{PIXELS}.encoder.{i}"]) for i in range(len(network.encoder))
        )
        self.decoder = nn.ModuleList(
            Up(Convolution(**stored[f"{PIXELS}.decoder.{i}.0"]),
               Convolution(**stored[f"{PIXELS}.decoder.{i}.2"], numbers=i == 0))
            for i in range(len(network.decoder))
        )  # fmt: skip
        self.last = network.last

    def input(self, lit: Tensor, albedo: Tensor, normal: Tensor) -> Tensor:
        """As that of `PixelNetwork`, in bytes."""
        return feature_bytes(lit, albedo, as_color(normal))


class ToBytes(nn.Module):
    """Numbers ≥ 0 in bytes, with a step for each channel."""

    def __init__(self, step: Tensor) -> None:
        super().__init__()
        self.register_buffer("scale", 1 / step.view(-1, 1, 1), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        # What is below the point is cut off. A whole number and a half is none in bfloat16 from 128 on: rounded to the
        # next one, it would be one too many.
        x = torch.addcmul(x.new_tensor(0.498), x, self.scale.to(x.dtype))
        return x.clamp_(max=255).to(torch.uint8, memory_format=torch.channels_last)


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
    results.
    """
    weights, factors = [], []
    for parts in phases(layer.weight, [len(step) for step in steps]):
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
