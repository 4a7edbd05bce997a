"""What is it worth that silhouettes before nothing are softened?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/still-life --set still-life --frames 8
    $render shots/still-life-reference --set still-life --frames 8 --samples 256 --seed 77
    python bench/diagnosis/soft_edges.py shots/still-life shots/meadow shots/cut-still-life ...

A shot's references lie in the folder of its name and "-reference"; those called "cut-" have a transparent film
(`--transparent`), `hair` has 256×144 pixels, and it and they have 128 samples in the reference. PSNR in dB at 1 sample
a pixel, of all frames but the first, and of their silhouettes: pixels beside which both a surface and nothing was hit.
Writes bench/results/soft_edges.json and the table of its note.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
import tyro
from torch import Tensor
from torch.nn import functional as F

from bench.diagnosis.outdated import METHODS
from bench.diagnosis.turned import paired
from rtdenoise.color import display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.metrics import psnr

RESULT, PAGES = RESULTS / "soft_edges.json", (DOCS / "notes" / "soft_edges.md",)
COMPARED = [method for method in METHODS if "single" not in method]
EDGES = "as rendered", "softened"


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of noisy frames."""
    rows = []
    for shot in shots:
        noisy = open_sequence(shot)
        for edges, sequence in zip(EDGES, (noisy, replace(noisy, soft_edges=True)), strict=True):
            frames = paired(sequence, f"{shot}-reference")
            for method in COMPARED:
                row = {"sequence": shot.name, "method": method, "edges": edges}
                rows.append(row | errors(frames, METHODS[method](frames)))
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def errors(frames: list[Frame], images: list[Tensor]) -> dict[str, float]:
    """Mean PSNR over the frame and at silhouettes."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    found: dict[str, list[float]] = {"frame": [], "silhouettes": []}
    for frame, image in list(zip(frames, images, strict=True))[1:]:
        hit = (frame.depth > 0).float()
        beside = F.max_pool2d(hit, 3, 1, 1) != -F.max_pool2d(-hit, 3, 1, 1)
        for place, where in (("frame", None), ("silhouettes", beside)):
            found[place].append(psnr(image, frame.reference, scale, where))
    return {place: sum(values) / len(values) for place, values in found.items()}


def tables(document: dict) -> dict[str, str]:
    """Section `soft-edges`: a row a method, before and after."""
    rows = {(row["sequence"], row["method"], row["edges"]): row for row in document["rows"]}
    shots = list(dict.fromkeys(row["sequence"] for row in document["rows"]))
    lines = ["| | " + " | ".join(shots) + " |", "|---|" + "---|" * len(shots)]
    for method in COMPARED:
        cells = []
        for shot in shots:
            before, after = (rows[shot, method, edges] for edges in EDGES)
            cells.append(f"{before['frame']:.2f} → {after['frame']:.2f}, "
                         f"{before['silhouettes']:.1f} → {after['silhouettes']:.1f}")  # fmt: skip
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    return {"soft-edges": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
