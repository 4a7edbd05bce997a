"""Join a hybrid of two models that ship: the kernels of one, and the network of a hybrid that writes pixels.

python tools/join_hybrid.py OUT KERNELS PIXELS    # rtdenoise/weights/hybrid-many.safetensors many hybrid

The file holds names alone. Kernels that keep no recent frames by themselves are taken for those of many samples.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from safetensors.numpy import save
from usage import call

from rtdenoise.files import write_atomically
from rtdenoise.models.hybrid_config import HybridConfig
from rtdenoise.models.weights import described, read_config


def main(out: str, kernels: str, pixels: str) -> None:
    of_kernels, of_pixels = read_config(kernels), read_config(pixels)
    config = HybridConfig(
        **asdict(of_kernels) | {"footprint": True, "recent": of_pixels.recent},
        many=not of_kernels.recent,
        **{name: getattr(of_pixels, name) for name in ("down", "up", "out", "twice", "clean")},
    )
    write_atomically(Path(out), save({}, metadata=described(config, kernels=kernels, pixels=pixels)))


if __name__ == "__main__":
    call(main, __doc__)
