"""Does `rtdenoise inspect --write` find out what motion vectors mean, at one sample a pixel?

python bench/diagnosis/vectors.py data/standard/{street,outdoor,staircase2,bathroom,dining-room,window}

The exact vectors of each sequence are stored as renderers store them, and read by what `run.vectors` finds. Writes
bench/results/vectors.json: whether that is right, and the factors of x and y over the right ones.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, harness

# isort: split
import torch
import tyro

from rtdenoise.data.layout import SCALES, pixels
from rtdenoise.data.opening import open_sequence
from rtdenoise.run.inspect import choose_pairs
from rtdenoise.run.vectors import Meaning, fit

RESULT = RESULTS / "vectors.json"
STORED = {  # offset, signs, pixels of a unit (or a scale), in half floats
    "pixels": (0.0, (1, 1), 1.0, False),
    "pixels around 0.5, y up": (0.5, (1, -1), 1.0, False),
    "fractions": (0.0, (1, 1), "uv", False),
    "halves of the picture, y up": (0.0, (1, -1), "ndc", False),
    "fractions around 0.5, negative, in half floats": (0.5, (-1, 1), "uv", True),
    "fractions of its double around 0.5, negative, in half floats": (0.5, (-1, -1), "2uv", True),
    "of a greatest movement of 64 pixels": (0.5, (1, 1), 128.0, False),
    "a third": (0.0, (1, 1), 3.0, False),
    "zero": (0.0, (0, 0), 1.0, False),
}


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for folder in sequences:
        sequence = open_sequence(folder)
        pairs = [(sequence[a], sequence[b]) for a, b in choose_pairs(sequence.numbers, sequence.size)]
        for name, (offset, signs, scale, half) in STORED.items():
            units = zip(signs, pixels(scale, sequence.size), strict=True)
            unit = torch.tensor([sign / factor for sign, factor in units]).view(1, 2, 1, 1)
            fields = [offset + now.motion * unit for _, now in pairs]
            found = fit(pairs, [field.half().float() if half else field for field in fields])
            rows.append({"sequence": folder.name, "stored": name, **judged(found, offset, signs, scale, sequence.size)})
            print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4)


def judged(found: Meaning, offset: float, signs: tuple[int, int], scale: float | str, size: tuple[int, int]) -> dict:
    """Whether what was found is right, or rightly not confirmed, and its factors over the right ones."""
    if not any(signs):
        return {"right": not found.confirmed, "confirmed": found.confirmed, "factors": None}
    pairs = zip(pixels(found.scale, size), pixels(scale, size), found.signs, signs, strict=True)
    over = [a * s / (b * t) for a, b, s, t in pairs]
    right = (found.offset, found.swapped, found.signs) == (offset, False, signs)
    exact = found.scale == scale if scale in (1.0, *SCALES) else all(abs(x - 1) < 0.1 for x in over)
    return {"right": bool(right and exact and found.confirmed), "confirmed": found.confirmed, "factors": over}


if __name__ == "__main__":
    harness.run(main, __doc__)
