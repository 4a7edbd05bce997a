"""Put a hybrid together: the kernels of a model that ships, and one of Open Image Denoise's networks.

python tools/begin_hybrid.py OUT [NETWORK [KERNELS]]    # NETWORK: fast, balanced (OIDN's qualities) or large

OIDN's library holds the weights of its filters, as TZA archives, under the Apache License 2.0; `pyoidn` brings it.
Taken is the filter of HDR colour, albedo and normal; `large` is that of clean albedo and normal, with those that clean
them. Its transfer function is log(1 + 178 · x) · 0.0615 but for the darkest parts.

The file names the kernels' model and holds the rest in half precision. Weights of `large` are whole numbers of eight
bits, but for those of the filter of light at full and half size, which would be seen.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import asdict, dataclass
from importlib.resources import files
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor
from usage import call

from rtdenoise.files import in_order, write_atomically
from rtdenoise.models.hybrid_config import HybridConfig, PixelShape
from rtdenoise.models.weights import UNIT, described, read_config

MAGIC = struct.pack("<HBB", 0x41D7, 2, 0)  # of a TZA archive, and its version
UP = ("dec_conv1", "dec_conv2", "dec_conv3", "dec_conv4")
SMALL = ("enc_conv0", "enc_conv1", "enc_conv2", "enc_conv3", "enc_conv4", "enc_conv5a", "enc_conv5b"), "dec_conv0"
LARGE = tuple(f"enc_conv{level}{part}" for level in range(1, 6) for part in "ab"), "dec_conv1c"
WHOLE = 127  # the greatest whole weight
FINE = (0, 1, 2, 3), (0, 1)  # convolutions and levels of `large` at full and half size


@dataclass(frozen=True)
class Archive:
    """A network in OIDN's library."""

    count: int  # numbers in it
    place: int = 0  # among the archives with as many
    names: tuple[tuple[str, ...], str] = SMALL  # of the convolutions on the way down, and of the last one


LIGHT = {"fast": Archive(320_035), "balanced": Archive(919_811), "large": Archive(3_848_387, names=LARGE)}
SURFACES = {"albedo": Archive(914_627), "normal": Archive(914_627, place=3)}


def main(out: str, quality: str = "balanced", kernels: str = "default") -> None:
    content, clean = library(), quality == "large"
    shape, tensors = network(content, LIGHT[quality], "pixels")
    if clean:
        for name, archive in SURFACES.items():
            tensors |= network(content, archive, f"pixels.surfaces.{name}")[1]
    shapes = {name: getattr(shape, name) for name in ("down", "up", "out", "twice")}
    config = HybridConfig(**asdict(read_config(kernels)) | {"footprint": True}, **shapes, clean=clean)
    encoder, decoder = FINE
    fine = *(f"pixels.encoder.{i}." for i in encoder), *(f"pixels.decoder.{i}." for i in decoder), "pixels.last."
    stored = {}
    for name, tensor in tensors.items():
        if clean and name.endswith("weight") and not name.startswith(fine):
            unit = tensor.abs().amax((1, 2, 3)) / WHOLE
            stored |= {name: (tensor / unit.view(-1, 1, 1, 1)).round().to(torch.int8), name + UNIT: unit}
        else:
            stored[name] = tensor.half()
    stored = {name: tensor.contiguous() for name, tensor in stored.items()}
    write_atomically(Path(out), in_order(save(stored, metadata=described(config, kernels=kernels))))


def network(content: bytes, archive: Archive, prefix: str) -> tuple[PixelShape, dict[str, Tensor]]:
    """The shape of a network of OIDN's, and its tensors by our names."""
    theirs, (down, last) = read(content, archive), archive.names
    width = {key.removesuffix(".bias"): len(x) for key, x in theirs.items() if key.endswith(".bias")}
    shape = PixelShape(
        inputs=theirs[f"{down[0]}.weight"].shape[1],
        down=tuple(width[name] for name in ends(down)),
        up=tuple(width[f"{name}a"] for name in UP),
        out=tuple(width[f"{name}b"] for name in UP),
        twice=archive.names == LARGE,
    )
    layers = {f"encoder.{i}": name for i, name in enumerate(down)} | {"last": last}
    for level, name in enumerate(UP):
        layers |= {f"decoder.{level}.0": f"{name}a", f"decoder.{level}.2": f"{name}b"}
    tensors = {}
    for ours, name in layers.items():
        tensors |= {f"{prefix}.{ours}.{kind}": theirs[f"{name}.{kind}"] for kind in ("weight", "bias")}
    return shape, tensors


def ends(down: tuple[str, ...]) -> list[str]:
    """Of convolutions on the way down the last one at each size, finest first."""
    layers = iter(down)
    stages = PixelShape(twice=down == LARGE[0]).stages
    return [list(islice(layers, count))[-1] for count in stages]


def library() -> bytes:
    """The library of `pyoidn` that holds the weights."""
    (path,) = Path(str(files("pyoidn"))).glob("oidn/lib/libOpenImageDenoise_core.so.*")
    return path.read_bytes()


def read(content: bytes, archive: Archive) -> dict[str, Tensor]:
    """The tensors of an archive."""
    start, place = -1, 0
    while (start := content.find(MAGIC, start + 1)) >= 0:
        try:
            tensors = parsed(content, start)
        except (struct.error, UnicodeDecodeError, ValueError, KeyError):
            continue  # these four bytes were something else
        if sum(x.numel() for x in tensors.values()) == archive.count:
            if place == archive.place:
                return tensors
            place += 1
    sys.exit("found no weights of the filter in OIDN's library")


def parsed(content: bytes, start: int) -> dict[str, Tensor]:
    """The tensors of the archive that begins at `start`: a table at its end names their shapes, types and places."""
    (place,) = struct.unpack_from("<Q", content, start + 4)
    place += start
    (count,), place = struct.unpack_from("<I", content, place), place + 4
    if count > 100:
        raise ValueError(count)
    tensors = {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", content, place)
        name = content[place + 2 : place + 2 + length].decode()
        place += 2 + length
        axes = content[place]
        shape = struct.unpack_from(f"<{axes}I", content, place + 1)
        place += 1 + 4 * axes + axes  # the layout is a letter an axis
        kind = {"h": np.float16, "f": np.float32}[chr(content[place])]
        (at,) = struct.unpack_from("<Q", content, place + 1)
        place += 9
        values = np.frombuffer(content, kind, int(np.prod(shape)), start + at).reshape(shape)
        tensors[name] = torch.from_numpy(values.astype(np.float32))
    return tensors


if __name__ == "__main__":
    call(main, __doc__)
