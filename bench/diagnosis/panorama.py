"""What is it worth to join a panorama at its edges?

    render="bpyenv/bin/python examples/blender/render.py --set panorama --frames 6 --width 512 --height 256"
    $render shots/panorama
    $render shots/panorama-reference --samples 96 --seed 77
    python bench/diagnosis/panorama.py shots/panorama

`denoise` as it is, and with `--no-detect-panorama`. PSNR at 1 sample a pixel, of all frames but the first: of the frame
and of the columns nearest to its edges. The step is the mean difference between the first and the last column, as a
multiple of that between both and the columns beside them: 1 where there is no seam. Writes
bench/results/panorama.json and the table of docs/use/blender.md.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor

from bench.diagnosis.turned import pictures_of_oidn
from rtdenoise.color import display, display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.metrics import psnr
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options
from rtdenoise.sanitise import sanitise

RESULT, PAGES = RESULTS / "panorama.json", (DOCS / "use" / "blender.md",)
NEAR = 8  # columns at either edge
METHODS = {
    "`denoise`": Options(),
    "`--lookahead 0`": Options(lookahead=0),
    "`--offline`": Options(offline=True),
}


def main(shot: tyro.conf.Positional[Path]) -> None:
    truths = [frame.radiance for frame in open_sequence(f"{shot}-reference")]
    frames = [sanitise(frame) for frame in open_sequence(shot)]
    rows = [{"method": "the reference", "step": step(truths)}, measured("OIDN", pictures_of_oidn(frames), truths)]
    for method, options in METHODS.items():
        for detect in (False, True):
            with tempfile.TemporaryDirectory() as folder:
                denoise(str(shot), folder, replace(options, detect_panorama=detect, float32=True))
                images = [frame.radiance for frame in open_sequence(folder)]
            rows.append(measured(method, images, truths) | {"joined": detect})
            print(rows[-1], flush=True)
    harness.publish(RESULT, {"sequence": shot.name, "near": NEAR, "rows": rows}, digits=4, pages=PAGES, tables=tables)


def measured(method: str, images: Sequence[Tensor], truths: Sequence[Tensor]) -> dict[str, object]:
    """A row: errors of all frames but the first, and the step at the edges."""
    scale = display_exposure(torch.cat(list(truths)))
    mask = torch.zeros_like(truths[0][:, :1], dtype=torch.bool)
    mask[..., :NEAR] = mask[..., -NEAR:] = True
    pairs = list(zip(images, truths, strict=True))[1:]
    found = {name: float(np.mean([psnr(image, truth, scale, where) for image, truth in pairs]))
             for name, where in (("frame", None), ("edges", mask))}  # fmt: skip
    return {"method": method, **found, "step": step(images)}


def step(images: Sequence[Tensor]) -> float:
    """The step at the edges of all frames but the first; the text above tells of it."""
    scale = display_exposure(torch.cat(list(images)))
    shown = display(torch.cat(list(images)[1:]), scale)
    across = (shown[..., 0] - shown[..., -1]).abs().mean()
    beside = (shown[..., 0] - shown[..., 1]).abs().mean() + (shown[..., -1] - shown[..., -2]).abs().mean()
    return (2 * across / beside).item()


def tables(document: dict) -> dict[str, str]:
    """Section `panorama`: each method, with its edges apart and joined."""
    lines = ["| | frame | columns at the edges | step |", "|---|---|---|---|"]
    for row in document["rows"]:
        told = {True: ", joined", False: ", edges apart"}.get(row.get("joined"), "")
        errors = (f"{row[name]:.1f} dB" if name in row else "" for name in ("frame", "edges"))
        lines.append(f"| {row['method']}{told} | {' | '.join(errors)} | {row['step']:.2f} |")
    return {"panorama": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
