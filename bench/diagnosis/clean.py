"""How should references of few samples be cleaned for training? OIDN's modes against references of many samples.

python bench/diagnosis/clean.py HELD

HELD/spp01, HELD/spp16 ... hold the same clips at several sample counts (`combine_clips.py --held-out`). Light of 16 or
32 samples stands for a reference, features are of one sample as in most clips, or of as many as the light has. Writes
bench/results/clean_modes.json and the table of docs/notes/clean.md.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.metrics.image import decibels, mse_corrected

RESULT, PAGES = RESULTS / "clean_modes.json", (DOCS / "notes" / "clean.md",)
LEVELS, FRAMES = (16, 32), 2
MODES = {
    "noisy": "not cleaned", "plain": "features of 1 spp", "prefiltered": "features of 1 spp, prefiltered",
    "clean features": "features of many samples, prefiltered",
}  # fmt: skip


@torch.inference_mode()
def main(held: tyro.conf.Positional[Path]) -> None:
    plain, prefiltered = Oidn(), Oidn(prefilter=True)
    few, rows = ClipDataset(held / "spp01"), []
    for spp in LEVELS:
        many = ClipDataset(held / f"spp{spp:02d}")
        for index, signal in ((i, s) for i in range(len(many)) for s in ("indirect", "color")):
            errors = {mode: [] for mode in MODES}
            pairs = (clips.load(index, signal=signal)[:FRAMES] for clips in (few, many))
            for one, frame in zip(*pairs, strict=True):
                scale, mixed = display_exposure(frame.reference), replace(one, radiance=frame.radiance)
                images = frame.radiance, plain.step(mixed)[0], prefiltered.step(mixed)[0], prefiltered.step(frame)[0]
                for mode, image in zip(MODES, images, strict=True):
                    half = frame.reference_half
                    errors[mode].append(mse_corrected(image, frame.reference, scale, reference_half=half))
            rows.append(
                {"scene": many.facts(index)["place"], "signal": signal, "spp": spp}
                | {mode: decibels(float(np.mean(found))) for mode, found in errors.items()}
            )
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `clean-modes`: corrected PSNR, mean over the scenes."""
    rows = document["rows"]
    cells = sorted({(row["spp"], row["signal"]) for row in rows})
    lines = ["| | " + " | ".join(f"{spp} spp, {signal}" for spp, signal in cells) + " |",
             "|---" * (len(cells) + 1) + "|"]  # fmt: skip
    for mode, label in MODES.items():
        means = (np.mean([r[mode] for r in rows if (r["spp"], r["signal"]) == cell]) for cell in cells)
        lines.append(f"| {label} | {' | '.join(f'{x:.2f}' for x in means)} |")
    return {"clean-modes": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
