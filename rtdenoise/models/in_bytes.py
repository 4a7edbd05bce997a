"""The network of `hybrid` that writes pixels, in bytes: less time than in bfloat16 on CPUs that multiply bytes.

Weights are whole numbers from -127 to 127 with a factor for each output, features whole numbers from 0 to 255 with a
step for each channel; sums are exact. Weights were rounded one by one, each so that it makes up for the errors of those
before, for what a layer sees in some frames (Frantar et al. 2023, *GPTQ*; docs/notes/bytes.md).
`tools/hybrid_in_bytes.py` makes them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from ..errors import InputError
from ..ops.convolve_bytes import BLOCK, QUAD, convolve_bytes
from ..ops.feature_bytes import CHANNELS, feature_bytes
from .hybrid import PixelNetwork
from .hybrid_config import HybridConfig


class InBytes(PixelNetwork):
    """A `PixelNetwork` without gradients."""

    def __init__(self, layers: dict[str, dict[str, Tensor]], network: PixelNetwork) -> None:
        """`layers` as `read` returns them, for those of `network`."""
        nn.Module.__init__(self)
        self.encoder = nn.ModuleList(Convolution(**layers[f"encoder.{i}"]) for i in range(len(network.encoder)))
        self.decoder = nn.ModuleList(
            Up(layers[f"decoder.{i}.0"], layers[f"decoder.{i}.2"], torch.uint8 if i else torch.bfloat16)
            for i in range(len(network.decoder))
        )
        self.last = network.last

    def input(self, radiance: Tensor, albedo: Tensor, normal: Tensor, scale: Tensor) -> Tensor:
        """As that of `PixelNetwork`, in bytes."""
        return feature_bytes(radiance, albedo, normal, scale)


class Convolution(nn.Module):
    """`convolve_bytes` with its weights."""

    def __init__(self, weight: Tensor, factor: Tensor, bias: Tensor, dtype: torch.dtype = torch.uint8) -> None:
        super().__init__()
        self.weight, self.factor, self.bias, self.dtype = weight, factor, bias, dtype

    def forward(self, x: Tensor, below: Tensor | None = None) -> Tensor:
        x = x.contiguous(memory_format=torch.channels_last)
        return convolve_bytes(x, self.weight, self.factor, self.bias, below, self.dtype)


class Up(nn.Module):
    """As `unet.Up`."""

    def __init__(self, first: dict[str, Tensor], second: dict[str, Tensor], dtype: torch.dtype) -> None:
        super().__init__()
        self.first, self.second = Convolution(**first), Convolution(**second, dtype=dtype)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        return self.second(self.first(skip, below=x))


def layout(config: HybridConfig) -> dict[str, tuple[list[tuple[int, int]], int]]:
    """Layer -> what it reads, as (channels, taps), the coarser picture first; and its outputs."""
    first, *others = config.convolutions
    layers = {"encoder.0": ([(CHANNELS, 3)], first[1])}
    layers |= {f"encoder.{i}": ([(inputs, 3)], outputs) for i, (inputs, outputs) in enumerate(others, 1)}
    for i, (below, middle, skip, outputs) in enumerate(config.levels):
        layers[f"decoder.{i}.0"] = [(below, 2), (skip if i else CHANNELS, 3)], middle
        layers[f"decoder.{i}.2"] = [(middle, 3)], outputs
    return layers


def shapes(config: HybridConfig) -> dict[str, tuple[int, ...]]:
    """Name -> shape of each tensor in a file of weights in bytes."""
    found = {}
    for name, (read, outputs) in layout(config).items():
        phases, quads = 4 if len(read) > 1 else 1, sum(C * K * K // QUAD for C, K in read)
        found[f"{name}.weight"] = phases, quads, -(-outputs // BLOCK) * BLOCK, QUAD
        found[f"{name}.factor"] = found[f"{name}.bias"] = phases, outputs
    return found


def read(path: Path, config: HybridConfig) -> dict[str, dict[str, Tensor]]:
    """Layer -> `weight`, `factor` and `bias` of `convolve_bytes`.

    Raises InputError where the file is missing, damaged, or of another network.
    """
    try:
        with safe_open(path, framework="numpy") as file:
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except FileNotFoundError:
        raise InputError(f"precision int8: there is no {path.name}, with weights in bytes, beside the model; take bf16 "
                         "or fp32, or make it (tools/hybrid_in_bytes.py)") from None  # fmt: skip
    except (SafetensorError, OSError, TypeError) as error:
        raise InputError(f"{path}: not a readable safetensors file ({error})") from None
    expected, layers = shapes(config), {}
    for name in sorted(expected.keys() | tensors.keys()):
        x, dtype = tensors.get(name), np.int8 if name.endswith("weight") else np.float32
        if x is None or x.shape != expected.get(name) or x.dtype != dtype or not np.isfinite(x).all():
            raise InputError(f"{path}: not the weights of this network in bytes: {name} is "
                             f"{'missing' if x is None else f'{x.dtype} {x.shape}'}, expected finite {dtype.__name__} "
                             f"{expected.get(name, 'none')}")  # fmt: skip
        layer, part = name.rsplit(".", 1)
        layers.setdefault(layer, {})[part] = torch.from_numpy(x)
    return layers
