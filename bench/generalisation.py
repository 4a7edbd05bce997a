"""Does a network do as well on clips of scenes it has not seen? Its lead over OIDN, folder by folder.

    python bench/generalisation.py CLIPS [CLIPS ...]

What is learnt by heart shows as a lead on the training clips that is lost on others; what training clips lack, as a
lead on them and on validation clips of their kind that is lost elsewhere. PSNR in dB of `COUNT` clips of each folder,
evenly taken, first frames and later ones apart, for either signal. Writes bench/results/generalisation.json and the
table of docs/training.md.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import harness
import numpy as np
import torch

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.metrics import psnr
from rtdenoise.models import load

RESULT, PAGE = harness.ROOT / "bench" / "results" / "generalisation.json", harness.ROOT / "docs" / "training.md"
COUNT = 20
MODELS = ("default", "fast", "quality")


def main(folders: list[Path]) -> None:
    steps = {name: load(name).step for name in MODELS} | {"oidn": Oidn().step}
    rows = []
    for folder in folders:
        for signal in ("indirect", "color"):
            rows.append({"clips": folder.name, "signal": signal} | lead(folder, signal, steps))
            print(rows[-1])
    harness.write(RESULT, digits=5, **harness.origin({"torch": harness.cpu()}), count=COUNT, rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


@torch.inference_mode()
def lead(folder: Path, signal: str, steps: dict) -> dict[str, dict[str, float]]:
    """Method -> mean PSNR of first frames and of later ones."""
    found: dict = {name: {"first": [], "later": []} for name in steps}
    for frames in harness.clips(folder, COUNT, signal):
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for name, step in steps.items():
            history = None
            for i, frame in enumerate(frames):
                image, history = step(frame, history)
                found[name]["later" if i else "first"].append(psnr(image, frame.reference, scale))
    return {name: {k: float(np.mean(v)) for k, v in frames.items()} for name, frames in found.items()}


def tables(document: dict) -> dict[str, str]:
    """The section of docs/training.md: by how many dB `default` is ahead."""
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
    main([Path(a) for a in sys.argv[1:]])
