"""Where is the error? Its share at edges, in textures and elsewhere.

python bench/diagnosis/where.py [SEQUENCE ...]

The corrected error (squared, on the display transform, minus the reference's own) of the bundled sequence and of
others, split by a pixel's 3×3 neighbourhood: an edge of geometry (depths differ by more than a tenth, or normals by
more than half a unit), else a texture (albedos differ by more than a tenth), else neither. Sequences without half
references are left out. Writes bench/results/where.json and the table of docs/results/quality.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, SAMPLE, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor
from torch.nn import functional as F

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.evaluate.inputs import Source
from rtdenoise.frame import Frame
from rtdenoise.metrics.image import decibels, mse_corrected
from rtdenoise.models import load

RESULT, PAGES = RESULTS / "where.json", (DOCS / "results" / "quality.md",)
MODELS = ("default", "fast")
KINDS = ("edges", "textures", "elsewhere")
MIN_DEPTH_STEP = 0.1  # of an edge, relative to the depth
MIN_NORMAL_STEP = 0.5  # of an edge
MIN_ALBEDO_STEP = 0.1  # of a texture


def main(sequences: tyro.conf.Positional[tuple[Path, ...]] = ()) -> None:
    steps = {"oidn": Oidn().step} | {name: load(name, precision="fp32").step for name in MODELS}
    rows = []
    for folder in [SAMPLE, *sequences]:
        for signal in ("indirect", "color"):
            source = Source.open(folder, signal, "auto", None)
            frames = source.frames(source.spp)
            if frames[0].reference_half is None:
                continue
            rows.append({"sequence": source.name, "signal": signal} | errors(frames, steps))
            print(rows[-1])
    harness.publish(RESULT, {"rows": rows}, digits=5, pages=PAGES, tables=tables)


@torch.inference_mode()
def errors(frames: list[Frame], steps: dict) -> dict[str, dict]:
    """'pixels': kind -> share of the pixels; method -> kind -> the kind's part of the mean corrected squared error."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    masks = [kinds(frame) for frame in frames]
    found: dict = {"pixels": {kind: float(np.mean([m[kind].float().mean() for m in masks])) for kind in KINDS}}
    for name, step in steps.items():
        total = dict.fromkeys(KINDS, 0.0)
        for image, frame, mask in zip(harness.denoise(step, frames), frames, masks, strict=True):
            for kind in KINDS:
                if (share := mask[kind].float().mean().item()) > 0:
                    half = frame.reference_half
                    error = mse_corrected(image, frame.reference, scale, mask[kind], reference_half=half)
                    total[kind] += share * error / len(frames)
        found[name] = total
    return found


def kinds(frame: Frame) -> dict[str, Tensor]:
    """Kind -> mask `[1, 1, H, W]` of its pixels."""
    depth_edges = _range(frame.depth) > MIN_DEPTH_STEP * frame.depth
    edges = depth_edges | (_range(frame.normal).amax(1, keepdim=True) > MIN_NORMAL_STEP)
    textures = ~edges & (_range(frame.albedo).amax(1, keepdim=True) > MIN_ALBEDO_STEP)
    return dict(zip(KINDS, (edges, textures, ~edges & ~textures), strict=True))


def _range(x: Tensor) -> Tensor:
    """Maximum minus minimum of each 3×3 neighbourhood."""
    return F.max_pool2d(x, 3, 1, 1) + F.max_pool2d(-x, 3, 1, 1)


def tables(document: dict) -> dict[str, str]:
    """Section `where`: shares of the error of `default`, and its gain over OIDN."""
    lines = [
        "| | signal | pixels at edges | in textures | error at edges | in textures | elsewhere | against OIDN, edges | "
        "textures | elsewhere |",
        "|---" * 10 + "|",
    ]
    for row in document["rows"]:
        ours, total = row["default"], sum(row["default"].values())
        cells = [f"{row['pixels'][kind]:.0%}" for kind in KINDS[:2]]
        cells += [f"{ours[kind] / total:.0%}" for kind in KINDS]
        cells += [f"{decibels(ours[kind]) - decibels(row['oidn'][kind]):+.2f} dB" for kind in KINDS]
        lines.append(f"| {row['sequence']} | {row['signal']} | {' | '.join(cells)} |")
    return {"where": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
