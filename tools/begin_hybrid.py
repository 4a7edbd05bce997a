"""Put `hybrid` or `hybrid-fast` together: the kernels of a model, and one of Open Image Denoise's networks.

python tools/begin_hybrid.py OUT [NETWORK [KERNELS]]    # NETWORK: balanced or fast, as OIDN's qualities

OIDN's library holds the weights of its filters, as TZA archives, under the Apache License 2.0; `pyoidn` brings it.
Taken is the filter of HDR colour, albedo and normal. Its transfer function is log(1 + 178 · x) · 0.0615 but for the
darkest parts.
"""

from __future__ import annotations

import struct
import sys
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from usage import call

from rtdenoise.models import read, save
from rtdenoise.models.hybrid import Hybrid
from rtdenoise.models.hybrid_config import HybridConfig

MAGIC = struct.pack("<HBB", 0x41D7, 2, 0)  # of a TZA archive, and its version
DOWN = ("enc_conv0", "enc_conv1", "enc_conv2", "enc_conv3", "enc_conv4", "enc_conv5a", "enc_conv5b")
UP = ("dec_conv1", "dec_conv2", "dec_conv3", "dec_conv4")
INPUTS = 9  # colour, albedo, normal
WEIGHTS = {"balanced": 919_811, "fast": 320_035}  # how many; the first of this size takes noisy albedo and normal
NORMAL = slice(6, 9)  # of its inputs; OIDN has normals in [0, 1]


def main(out: str, quality: str = "balanced", kernels: str = "default") -> None:
    network, theirs = read(kernels), archive(library(), WEIGHTS[quality])
    width = {key.removesuffix(".bias"): len(x) for key, x in theirs.items() if key.endswith(".bias")}
    config = HybridConfig(
        **asdict(network.config) | {"footprint": True},
        down=tuple(width[name] for name in (*DOWN[1:5], DOWN[6])),
        up=tuple(width[f"{name}a"] for name in UP),
        out=tuple(width[f"{name}b"] for name in UP),
    )
    hybrid = Hybrid(config)
    state = hybrid.state_dict() | network.state_dict()
    layers = {f"encoder.{i}": name for i, name in enumerate(DOWN)}
    for level, name in enumerate(UP):
        layers |= {f"decoder.{level}.0": f"{name}a", f"decoder.{level}.2": f"{name}b"}
    for ours, name in layers.items():
        weight, bias = theirs[f"{name}.weight"], theirs[f"{name}.bias"]
        if name in ("enc_conv0", "dec_conv1a"):  # which see the input
            weight, bias = with_our_normals(weight, bias)
        state |= {f"pixels.{ours}.weight": weight, f"pixels.{ours}.bias": bias}
    state |= {f"pixels.last.{key}": theirs[f"dec_conv0.{key}"] for key in ("weight", "bias")}
    hybrid.load_state_dict(state)
    save(hybrid, out)


def library() -> bytes:
    """The library of `pyoidn` that holds the weights."""
    (path,) = Path(str(files("pyoidn"))).glob("oidn/lib/libOpenImageDenoise_core.so.*")
    return path.read_bytes()


def archive(content: bytes, count: int) -> dict[str, Tensor]:
    """The tensors of the first archive with `count` numbers."""
    start = -1
    while (start := content.find(MAGIC, start + 1)) >= 0:
        try:
            tensors = parsed(content, start)
        except (struct.error, UnicodeDecodeError, ValueError, KeyError):
            continue  # these four bytes were something else
        if sum(x.numel() for x in tensors.values()) == count:
            return tensors
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


def with_our_normals(weight: Tensor, bias: Tensor) -> tuple[Tensor, Tensor]:
    """A layer whose last inputs are OIDN's, for normals in [-1, 1]."""
    weight, before = weight.clone(), weight.shape[1] - INPUTS
    normal = weight[:, before:][:, NORMAL]
    bias = bias + 0.5 * normal.sum((1, 2, 3))
    normal *= 0.5
    return weight, bias


if __name__ == "__main__":
    call(main, __doc__)
