"""Make the bundled sequences small.

python tools/pack_sample.py data/sample samples/mural
python tools/pack_sample.py samples/mural samples/mural-window --signal indirect --window 26 20 112 184

Takes the first frames of a sequence that `rtdenoise render sample` wrote and drops precision below its noise. Noisy
layers and features are rounded, so that lossless compression works better: the noise of one sample per pixel is above
100 %, and 4 bits of mantissa resolve it. References go into a part of their own with DWAA compression, whose loss is
less than half of their own noise. The second command makes the sequence that the wheel holds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import OpenEXR

from rtdenoise.data.exr import read_channels, read_header

# Layers without a name here are left out.
MANTISSA_BITS = {"color": 4, "indirect": 4}  # of a half's 10
GRID_STEP = {"albedo": 1 / 128, "normal": 1 / 64, "depth": 1 / 64, "motion": 1 / 32, "motion_next": 1 / 32}
FRAMES = 9
REFERENCES = ("reference", "indirect_reference", "indirect_reference_half")
OLD_NAMES = {"half_indirect_reference": "indirect_reference_half"}  # of the bundled sequence
LEFT_OUT = {  # layers, by the signal that is kept
    None: (),
    "color": ("indirect", "indirect_reference", "indirect_reference_half"),
    "indirect": ("color", "reference", "indirect_reference_half"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("source", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--signal", choices=("color", "indirect"), help="keep one signal, without a half reference")
    parser.add_argument("--window", type=int, nargs=4, metavar=("TOP", "LEFT", "HEIGHT", "WIDTH"), help="keep a part")
    options = parser.parse_args()
    top, left, height, width = options.window or (0, 0, None, None)
    place = np.s_[top : height and top + height, left : width and left + width]
    pack(options.source, options.out, LEFT_OUT[options.signal], place)


def pack(source: Path, out: Path, left_out: tuple[str, ...], place: tuple[slice, slice]) -> None:
    """Write the part `place` of the first frames into `out`, but for some layers."""
    out.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.glob("*.exr"))[:FRAMES]:
        channels = read_channels(path, list(read_header(path).channels))
        rounded, references = {}, {}
        for name, whole in channels.items():
            prefix, _, component = name.rpartition(".")
            layer, values = OLD_NAMES.get(prefix, prefix) or "color", np.ascontiguousarray(whole[place])
            if layer in left_out:
                continue
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
    main()
