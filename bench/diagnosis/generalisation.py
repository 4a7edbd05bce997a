"""Does a network do as well on scenes that it was not trained on? Its lead over OIDN, folder by folder.

python bench/diagnosis/generalisation.py CLIPS [CLIPS ...]

A lead on training clips alone is overfitting. A lead on training and validation clips of one kind, but not on other
scenes, means that the training clips lack something. PSNR in dB of `COUNT` evenly spaced
clips of each folder, first frames and later ones apart, for both signals. Writes bench/results/generalisation.json and
the table of docs/results/training.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.metrics import psnr
from rtdenoise.models import load

RESULT, PAGES = RESULTS / "generalisation.json", (DOCS / "results" / "training.md",)
COUNT = 20  # clips of each folder
MODELS = ("default", "fast")


def main(folder: tyro.conf.Positional[Path], more: tyro.conf.Positional[tuple[Path, ...]] = ()) -> None:
    folders = [folder, *more]
    steps = {name: load(name, precision="fp32").step for name in MODELS} | {"oidn": Oidn().step}
    rows = []
    for folder in folders:
        for signal in ("indirect", "color"):
            rows.append({"clips": folder.name, "signal": signal} | lead(folder, signal, steps))
            print(rows[-1])
    harness.publish(RESULT, {"count": COUNT, "rows": rows}, digits=5, pages=PAGES, tables=tables)


@torch.inference_mode()
def lead(folder: Path, signal: str, steps: dict) -> dict[str, dict[str, float]]:
    """Method -> mean PSNR of first frames and of later ones."""
    found: dict = {name: {"first": [], "later": []} for name in steps}
    for frames in harness.clips(folder, COUNT, signal):
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for name, step in steps.items():
            for i, image in enumerate(harness.denoise(step, frames)):
                found[name]["later" if i else "first"].append(psnr(image, frames[i].reference, scale))
    return {name: {k: float(np.mean(v)) for k, v in frames.items()} for name, frames in found.items()}


def tables(document: dict) -> dict[str, str]:
    """Section `generalisation`: the lead of `default` in dB."""
    lines = [
        "| clips | indirect, first frames | indirect, later | beauty, first frames | beauty, later |",
        "|---" * 5 + "|",
    ]
    cells: dict[str, list[str]] = {}
    for row in document["rows"]:  # indirect light, then beauty
        ahead = (row["default"][k] - row["oidn"][k] for k in ("first", "later"))
        cells.setdefault(row["clips"], []).extend(f"{a:+.2f}" for a in ahead)
    lines += [f"| `{clips}` | {' | '.join(leads)} |" for clips, leads in cells.items()]
    return {"generalisation": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
