"""Make the bundled sample small.   python tools/pack_sample.py data/sample samples/mural

Takes the first frames of a sequence that `rtdenoise render sample` wrote and drops what nobody can tell apart. Noisy
layers and features are rounded, so that lossless compression has less to keep: the noise of one sample a pixel is above
100 %, and 4 bits of mantissa say all there is to say about it. References go into a part of their own with DWAA
compression, which is lossy, by less than half of their own noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import OpenEXR

from rtdenoise.data.exr import read_channels, read_header

# Bits of the half's 10-bit mantissa to keep, or the step of a fixed grid; layers that are not named are left out.
MANTISSA = {"color": 4, "indirect": 4}
GRID = {"albedo": 1 / 128, "normal": 1 / 64, "depth": 1 / 64, "motion": 1 / 32, "motion_next": 1 / 32}
FRAMES = 9
REFERENCES = ("reference", "indirect_reference", "half_indirect_reference")


def main(source: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.glob("*.exr"))[:FRAMES]:
        channels = read_channels(path, list(read_header(path).channels))
        rounded, references = {}, {}
        for name, values in channels.items():
            layer = name.rpartition(".")[0] or "color"
            if layer in MANTISSA:
                rounded[name] = round_mantissa(values, MANTISSA[layer])
            elif layer in GRID:
                rounded[name] = (np.round(values / GRID[layer]) * GRID[layer]).astype(np.float16)
            elif layer in REFERENCES:
                references[name] = values.astype(np.float16)
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
    """Halves `[H, W]`, rounded to the nearest with `bits` bits of mantissa."""
    drop = 10 - bits
    word = np.minimum(values, 60000).astype(np.float16).view(np.uint16).astype(np.uint32)
    return ((word + (1 << drop >> 1)) >> drop << drop).astype(np.uint16).view(np.float16)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
