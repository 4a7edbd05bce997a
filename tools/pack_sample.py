"""Make the bundled sequence small.   python tools/pack_sample.py data/sample samples/mural

Takes the first frames of a sequence that `rtdenoise render sample` wrote and drops precision below its noise. Noisy
layers and features are rounded, so that lossless compression works better: the noise of one sample per pixel is above
100 %, and 4 bits of mantissa resolve it. References go into a part of their own with DWAA compression, whose loss is
less than half of their own noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import OpenEXR

from rtdenoise.data.exr import read_channels, read_header

# Layers without a name here are left out.
MANTISSA_BITS = {"color": 4, "indirect": 4}  # of a half's 10
GRID_STEP = {"albedo": 1 / 128, "normal": 1 / 64, "depth": 1 / 64, "motion": 1 / 32, "motion_next": 1 / 32}
FRAMES = 9
REFERENCES = ("reference", "indirect_reference", "indirect_reference_half")
OLD_NAMES = {"half_indirect_reference": "indirect_reference_half"}


def main(source: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.glob("*.exr"))[:FRAMES]:
        channels = read_channels(path, list(read_header(path).channels))
        rounded, references = {}, {}
        for name, values in channels.items():
            prefix, _, component = name.rpartition(".")
            layer = OLD_NAMES.get(prefix, prefix) or "color"
            if layer in MANTISSA_BITS:
                rounded[name] = round_mantissa(values, MANTISSA_BITS[layer])
            elif layer in GRID_STEP:
                rounded[name] = (np.round(values / GRID_STEP[layer]) * GRID_STEP[layer]).astype(np.float16)
            elif layer in REFERENCES:
                references[f"{layer}.{component}"] = values.astype(np.float16)
        parts = [
            OpenEXR.Part({"compression": OpenEXR.ZIP_COMPRESSION}, rounded, "color"),
            OpenEXR.Part(
                {"compression": OpenEXR.DWAA_COMPRESSION, "dwaCompressionLevel": 250.0}, references, "references"
            ),
        ]
        OpenEXR.File(parts).write(str(out / path.name))
    total = sum(path.stat().st_size for path in out.glob("*.exr"))
    print(f"{out}: {total / 1e6:.2f} MB")


def round_mantissa(values: np.ndarray, bits: int) -> np.ndarray:
    """Halves `[H, W]`, rounded to the nearest number with this many bits of mantissa."""
    drop = 10 - bits
    word = np.minimum(values, 60000).astype(np.float16).view(np.uint16).astype(np.uint32)
    return ((word + (1 << drop >> 1)) >> drop << drop).astype(np.uint16).view(np.float16)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
