"""The error that bfloat16 adds: the shipped models on the bundled sequence in both precisions.

python bench/precision.py
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, harness

# isort: split
import numpy as np
import torch

from rtdenoise import models
from rtdenoise.color import display_exposure
from rtdenoise.metrics import psnr, relmse

RESULT = RESULTS / "precision.json"
SKIP = 1  # frames: the first has no history


def main() -> None:
    frames = harness.mural("indirect", layers=("reference", "reference_half"))
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    rows = []
    for name in models.available():
        images = {p: harness.denoise(models.load(name, precision=p).step, frames) for p in ("fp32", "bf16")}
        for precision, results in images.items():
            pairs = list(zip(results, frames, strict=True))[SKIP:]
            rows.append({
                "model": name,
                "precision": precision,
                "psnr": float(np.mean([psnr(i, f.reference, scale) for i, f in pairs])),
                "relmse": float(np.mean([relmse(i, f.reference, scale, None, f.reference_half) for i, f in pairs])),
                "psnr_against_fp32": float(np.mean([
                    psnr(i, reference, scale) for i, reference in zip(results, images["fp32"], strict=True)
                ])) if precision != "fp32" else None,
            })  # fmt: skip
            print(rows[-1])
    harness.publish(RESULT, {"rows": rows})


if __name__ == "__main__":
    harness.run(main, __doc__)
