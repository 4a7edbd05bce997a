"""Is the running mean given up as often as it should be? `default`, giving it up half and twice as far.

    python bench/patience.py CLIPS_OR_SEQUENCE [...]

The network is made to say half and twice what it says of `reset`, which it was not trained for: where half is better,
the clips that it was trained on were less calm than these. PSNR in dB of indirect light, of frames from the fifth on:
of `COUNT` clips of a folder of clips, evenly taken, or of 16 frames of a sequence. Writes bench/results/patience.json
and the table of docs/training.md.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import harness
import numpy as np
import torch

from rtdenoise.color import display_exposure
from rtdenoise.evaluate.inputs import Source
from rtdenoise.frame import Frame
from rtdenoise.metrics import psnr
from rtdenoise.models import AccumulatedKPN, load

RESULT, PAGE = harness.ROOT / "bench" / "results" / "patience.json", harness.ROOT / "docs" / "training.md"
COUNT, SETTLED = 24, 4
FACTORS = (0.5, 1.0, 2.0)


class Scaled(AccumulatedKPN):
    """`default` with what it says of `reset` times a factor."""

    factor = 1.0

    def predict(self, features: torch.Tensor):
        heads = super().predict(features)
        return replace(heads, reset=(self.factor * heads.reset).clamp(max=1))


def main(folders: list[Path]) -> None:
    model = load("default")
    model.__class__ = Scaled
    rows = []
    for folder in folders:
        rows.append({"of": folder.name} | found(folder, model))
        print(rows[-1])
    harness.write(RESULT, digits=5, **harness.origin({"torch": harness.cpu()}), factors=FACTORS, rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


@torch.inference_mode()
def found(folder: Path, model: Scaled) -> dict[str, list[float]]:
    """For each factor, means over the settled frames: PSNR, and frames in the running mean."""
    errors: list[list[float]] = [[] for _ in FACTORS]
    lengths: list[list[float]] = [[] for _ in FACTORS]
    for frames in shots(folder):
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for i, model.factor in enumerate(FACTORS):
            history = None
            for number, frame in enumerate(frames):
                image, history = model.step(frame, history)
                if number >= SETTLED:
                    errors[i].append(psnr(image, frame.reference, scale))
                    lengths[i].append(history.length.mean().item())
    return {"psnr": [float(np.mean(e)) for e in errors], "length": [float(np.mean(n)) for n in lengths]}


def shots(folder: Path) -> Iterator[list[Frame]]:
    """The clips of a folder of clips, or the beginning of the sequence that it is."""
    if next(folder.glob("clip_*.safetensors"), None):
        yield from harness.clips(folder, COUNT, "indirect")
    else:
        source = Source.open(folder, "indirect", "auto", None)
        yield source.frames(source.spp)[:16]


def tables(document: dict) -> dict[str, str]:
    lines = ["| | half as far | as it is | twice as far | frames in the mean |", "|---" * 5 + "|"]
    for row in document["rows"]:
        half, usual, twice = row["psnr"]
        lines.append(f"| `{row['of']}` | {half - usual:+.2f} | {usual:.2f} dB | {twice - usual:+.2f} | "
                     f"{row['length'][1]:.1f} |")  # fmt: skip
    return {"patience": "\n".join(lines)}


if __name__ == "__main__":
    main([Path(a) for a in sys.argv[1:]])
