"""Which layers a network in bytes has, and the file that holds their weights (`in_bytes`)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from ..errors import InputError
from ..ops.convolve_bytes import BLOCK, MOST, QUAD
from ..ops.feature_bytes import CHANNELS
from .config import AccumulatedKPNConfig
from .hybrid_config import HybridConfig, PixelShape
from .presets import Config
from .weights import KERNELS, PIXELS, bytes_of, files_of, parts_of, read_config

UNET = "unet"  # the networks, UNET and PIXELS, are the modules of these names
INPUT = "input"  # of a network, as a layer
CAREFUL = 2  # sizes, the finest first, that are rounded with care where albedo and normal are clean: it is seen there


@dataclass(frozen=True)
class Picture:
    """What a layer reads of another one."""

    maker: str  # the other layer
    channels: int
    taps: int  # the side of the kernel: 2 for a coarser picture, which is enlarged


@dataclass(frozen=True)
class Layer:
    """A convolution in bytes."""

    reads: tuple[Picture, ...]  # the coarser picture first
    outputs: int
    numbers: bool = False  # its results are bfloat16, not bytes
    careful: bool = False  # its weights stand in the file; else they are rounded to the nearest as they are loaded

    @property
    def phases(self) -> int:
        """As those of `convolve_bytes`."""
        return 4 if len(self.reads) > 1 else 1


def layout(config: Config) -> dict[str, Layer]:
    """Name of each layer in bytes -> the layer.

    Raises InputError where networks of this architecture have none, or `convolve_bytes` does not take the widths.
    """
    if not isinstance(config, AccumulatedKPNConfig):
        raise InputError(f"precision int8: networks of the form {config.architecture} have no weights in bytes; take "
                         "auto")  # fmt: skip
    layers = _unet(config.widths)
    if isinstance(config, HybridConfig):
        levels = CAREFUL if config.clean else len(config.pixels.levels) + 1
        layers |= _pixels(config.pixels, PIXELS, CHANNELS, levels)
        for name, shape in config.surfaces.items():
            layers |= _pixels(shape, f"{PIXELS}.surfaces.{name}", QUAD)
    for name, layer in layers.items():
        if any(picture.channels % QUAD or picture.channels > MOST for picture in layer.reads):
            raise InputError(f"precision int8: expected widths that are multiples of {QUAD} up to {MOST}; {name} reads "
                             f"{' and '.join(str(picture.channels) for picture in layer.reads)}")  # fmt: skip
    return layers


def _unet(widths: tuple[int, ...]) -> dict[str, Layer]:
    """That of `unet.UNet`."""
    maker, inputs, layers = f"{UNET}.{INPUT}", widths[0], {}
    for i, width in enumerate(widths):
        name = f"{UNET}.encoder.{i}"
        layers[f"{name}.0"] = Layer((Picture(maker, inputs, 3),), width)
        layers[f"{name}.2"] = Layer((Picture(f"{name}.0", width, 3),), width)
        maker, inputs = f"{name}.2", width
    for i, width in reversed(list(enumerate(widths[:-1]))):
        name = f"{UNET}.decoder.{i}"
        layers[f"{name}.0"] = Layer((Picture(maker, inputs, 2), Picture(f"{UNET}.encoder.{i}.2", width, 3)), width)
        layers[f"{name}.2"] = Layer((Picture(f"{name}.0", width, 3),), width, numbers=i == 0)
        maker, inputs = f"{name}.2", width
    return layers


def _pixels(shape: PixelShape, prefix: str, inputs: int, careful: int = 0) -> dict[str, Layer]:
    """That of `pixel_network.PixelUNet`, whose input has `inputs` channels; its layers at the finest `careful` sizes
    are rounded with care."""
    maker, below, layers = f"{prefix}.{INPUT}", inputs, {}
    sizes = [level for level, count in enumerate(shape.stages) for _ in range(count)]
    for i, ((_, width), level) in enumerate(zip(shape.convolutions, sizes, strict=True)):
        name = f"{prefix}.encoder.{i}"
        layers[name] = Layer((Picture(maker, below, 3),), width, careful=level < careful)
        maker, below = name, width
    for i, (_, middle, skip, width) in reversed(list(enumerate(shape.levels))):
        name = f"{prefix}.decoder.{i}"
        pooled = f"{prefix}.encoder.{sum(shape.stages[:i]) - 1}"
        beside = Picture(pooled, skip, 3) if i else Picture(f"{prefix}.{INPUT}", inputs, 3)
        layers[f"{name}.0"] = Layer((Picture(maker, below, 2), beside), middle, careful=i < careful)
        layers[f"{name}.2"] = Layer((Picture(f"{name}.0", middle, 3),), width, numbers=i == 0, careful=i < careful)
        maker, below = f"{name}.2", width
    return layers


def shapes(config: Config) -> dict[str, tuple[int, ...]]:
    """Name -> shape of each tensor in the file: the arguments of `convolve_bytes` of layers that are rounded with care;
    what 1 of a byte is worth where another layer reads it or makes it. Raises InputError as `layout`."""
    layers = layout(config)
    found: dict[str, tuple[int, ...]] = {f"{UNET}.{INPUT}.step": (config.widths[0],)}
    stepped = {name for name, layer in layers.items() if not layer.careful}
    stepped |= {picture.maker for name in stepped for picture in layers[name].reads}
    for name, layer in layers.items():
        if name in stepped:
            found[f"{name}.step"] = (layer.outputs,)
        if layer.careful:
            quads = sum(picture.channels * picture.taps**2 // QUAD for picture in layer.reads)
            found[f"{name}.weight"] = layer.phases, quads, -(-layer.outputs // BLOCK) * BLOCK, QUAD
            found[f"{name}.factor"] = found[f"{name}.bias"] = layer.phases, layer.outputs
    return found


def made_for(model: Path) -> dict[str, str]:
    """What the file's metadata say of the model's files, whose weights it goes with."""
    return {"model": hashlib.sha256(b"".join(path.read_bytes() for path in files_of(model))).hexdigest()}


def read(model: Path, config: Config) -> dict[str, dict[str, Tensor]]:
    """Layer -> its tensors (`shapes`), for the weights in the file `model`: of the file in bytes beside it, or of those
    of the models whose weights it takes (`weights.parts_of`). These need have none of `PIXELS`.

    Raises InputError as `layout`, and where the file is missing, damaged, or was made for other weights.
    """
    if not bytes_of(model).is_file() and KERNELS in (parts := parts_of(model)):
        found = {part: read(other, read_config(other)) for part, other in parts.items()}
        return {name: layer for part, of_part in found.items() for name, layer in of_part.items()
                if name.startswith(f"{PIXELS}.") == (part == PIXELS)}  # fmt: skip
    path, expected, layers = bytes_of(model), shapes(config), {}
    try:
        with safe_open(path, framework="numpy") as file:
            other = not made_for(model).items() <= (file.metadata() or {}).items()
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except FileNotFoundError:
        raise InputError(f"precision int8: there is no {path.name} beside the model, which says what it needs; take "
                         "bf16 or fp32, or make it (tools/weights_in_bytes.py)") from None  # fmt: skip
    except (SafetensorError, OSError, TypeError) as error:
        raise InputError(f"{path}: not a readable safetensors file ({error})") from None
    if other:
        raise InputError(f"{path}: was made for other weights than {model.name} has; make it anew "
                         "(tools/weights_in_bytes.py)")  # fmt: skip
    for name in sorted(expected.keys() | tensors.keys()):
        x, dtype = tensors.get(name), np.int8 if name.endswith("weight") else np.float32
        if x is None or x.shape != expected.get(name) or x.dtype != dtype or not np.isfinite(x).all():
            raise InputError(f"{path}: not the weights of this network in bytes: {name} is "
                             f"{'missing' if x is None else f'{x.dtype} {x.shape}'}, expected finite {dtype.__name__} "
                             f"{expected.get(name, 'none')}")  # fmt: skip
        layer, part = name.rsplit(".", 1)
        layers.setdefault(layer, {})[part] = torch.from_numpy(x)
    return layers
