"""The cost of a missing layer: `rtdenoise.Denoiser` on the bundled sequence, each layer left out in turn.

python bench/missing_layers.py
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, ROOT, harness

# isort: split
import numpy as np
import torch

from rtdenoise import Denoiser
from rtdenoise.color import display_exposure
from rtdenoise.frame import Frame
from rtdenoise.metrics import psnr

RESULT = RESULTS / "missing_layers.json"
PAGES = (ROOT / "docs" / "use" / "python.md",)
SKIP = 1  # frames: the first has no history
EFFECTS = {  # of a missing layer
    "albedo": "textures blur",
    "normal": "edges between surfaces blur; the sequence has few",
    "depth": "outlines blur, cuts are not seen",
    "motion": "each frame is denoised alone, and flickers",
    "motion_next": "is [approximated](motion.md) from `motion` and `depth`",
}


def main() -> None:
    rows = []
    for signal in ("color", "indirect"):
        frames = harness.mural(signal, layers=("reference",))
        full = mean_psnr(frames, "")
        rows += [{"signal": signal, "missing": layer, "psnr": mean_psnr(frames, layer) - full} for layer in EFFECTS]
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def mean_psnr(frames: list[Frame], missing: str) -> float:
    """Mean PSNR in dB of all frames but the first, without a layer."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    denoiser, values = Denoiser(precision="fp32"), []
    for frame in frames:
        layers = {layer: getattr(frame, layer) for layer in EFFECTS if layer != missing}
        values.append(psnr(denoiser(frame.radiance, **layers), frame.reference, scale))
    return float(np.mean(values[SKIP:]))


def tables(document: dict) -> dict[str, str]:
    change = {(row["signal"], row["missing"]): row["psnr"] for row in document["rows"]}
    lines = ["| missing | effect | PSNR, beauty | indirect light |", "|---|---|---|---|"]
    for layer, effect in EFFECTS.items():
        dB = [f"{change[signal, layer]:+.1f} dB".replace("-", "−") for signal in ("color", "indirect")]
        lines.append(f"| `{layer}` | {effect} | {dB[0]} | {dB[1]} |")
    return {"missing-layers": "\n".join(lines)}


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # a layer is missing
    harness.run(main, __doc__)
