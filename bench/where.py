"""Where is the error? Its share at edges of things, in textures and elsewhere.

    python bench/where.py [SEQUENCE ...]

The corrected error (squares on the display transform, less the reference's own) of the bundled sequence, and of what
else is given, by what a pixel's 3×3 show: an edge of geometry (depths that differ by more than a tenth, or normals by
more than half a unit), else a texture (albedos that differ by more than a tenth), else neither. Sequences whose
references have no halves are left out. Writes bench/results/where.json and the table of docs/quality.md.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import harness
import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.evaluate.inputs import Source
from rtdenoise.frame import Frame
from rtdenoise.metrics.image import decibels, mse_corrected
from rtdenoise.models import load

RESULT, PAGE = harness.ROOT / "bench" / "results" / "where.json", harness.ROOT / "docs" / "quality.md"
MODELS = ("default", "fast", "quality")
KINDS = ("edges", "textures", "elsewhere")


def main(folders: list[Path]) -> None:
    steps = {"oidn": Oidn().step} | {name: load(name).step for name in MODELS}
    rows = []
    for folder in [harness.ROOT / "samples" / "mural", *folders]:
        for signal in ("indirect", "color"):
            source = Source.open(folder, signal, "auto", None)
            frames = source.frames(source.spp)
            if frames[0].reference_half is None:
                continue
            rows.append({"sequence": source.name, "signal": signal} | errors(frames, steps))
            print(rows[-1])
    harness.write(RESULT, digits=5, **harness.origin({"torch": harness.cpu()}), rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


@torch.inference_mode()
def errors(frames: list[Frame], steps: dict) -> dict[str, dict]:
    """'pixels': kind -> share of them; method -> kind -> corrected squared error, summed, in 1 / all pixels."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    masks = [kinds(frame) for frame in frames]
    found: dict = {"pixels": {kind: float(np.mean([m[kind].float().mean() for m in masks])) for kind in KINDS}}
    for name, step in steps.items():
        history, total = None, dict.fromkeys(KINDS, 0.0)
        for frame, mask in zip(frames, masks, strict=True):
            image, history = step(frame, history)
            for kind in KINDS:
                if (share := mask[kind].float().mean().item()) > 0:
                    half = frame.reference_half
                    error = mse_corrected(image, frame.reference, scale, mask[kind], reference_half=half)
                    total[kind] += share * error / len(frames)
        found[name] = total
    return found


def kinds(frame: Frame) -> dict[str, Tensor]:
    """Kind -> the pixels of it, [1, 1, H, W] bool."""
    edges = (_range(frame.depth) > 0.1 * frame.depth) | (_range(frame.normal).amax(1, keepdim=True) > 0.5)
    textures = ~edges & (_range(frame.albedo).amax(1, keepdim=True) > 0.1)
    return dict(zip(KINDS, (edges, textures, ~edges & ~textures), strict=True))


def _range(x: Tensor) -> Tensor:
    """Greatest less least of each 3×3."""
    return F.max_pool2d(x, 3, 1, 1) + F.max_pool2d(-x, 3, 1, 1)


def tables(document: dict) -> dict[str, str]:
    """The section of docs/quality.md: of `default`, and how it compares with OIDN."""
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
    main([Path(a) for a in sys.argv[1:]])
