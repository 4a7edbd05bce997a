"""Is the error noise or blur? Variance and squared bias of what comes out, from two renderings of the same frames.

    python bench/bias.py SEQUENCE AGAIN [SEQUENCE AGAIN ...]

The renderings of a pair differ in their samples alone (`rtdenoise render --seed`). Half the mean squared difference of
what a denoiser makes of them is its variance; the rest of its corrected error (`metrics.image.mse_corrected`) is
squared bias, which stays however many runs are averaged: what is blurred. By what a pixel's 3×3 show, as in `where.py`.
Writes bench/results/bias.json and the table of docs/quality.md.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import harness
import torch
from where import KINDS, kinds

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.sequences import open_sequence
from rtdenoise.evaluate.inputs import Source
from rtdenoise.frame import Frame
from rtdenoise.metrics.image import decibels, mse, mse_corrected
from rtdenoise.models import load

RESULT, PAGE = harness.ROOT / "bench" / "results" / "bias.json", harness.ROOT / "docs" / "quality.md"
FIRST = 4  # frame from which on: before it histories are short


def main(pairs: list[tuple[Path, Path]]) -> None:
    steps = {"oidn": Oidn().step} | {name: load(name, precision="fp32").step for name in ("fast", "default", "quality")}
    rows = []
    for folder, again in pairs:
        for signal in ("indirect", "color"):
            source = Source.open(folder, signal, "auto", None)
            frames = source.frames(source.spp)
            if frames[0].reference_half is None:
                continue
            for name, step in steps.items():
                found = errors(frames, list(open_sequence(again, signal=signal)), step)
                rows.append({"sequence": source.name, "signal": signal, "method": name} | found)
                print(rows[-1])
    harness.write(RESULT, digits=5, **harness.origin({"torch": harness.cpu()}), rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


@torch.inference_mode()
def errors(frames: list[Frame], again: list[Frame], step) -> dict[str, dict[str, float]]:
    """kind of pixel -> 'error', corrected, and 'variance', both in 1 / all pixels, mean over frames."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    found = {kind: {"error": 0.0, "variance": 0.0} for kind in KINDS}
    histories, pairs = [None, None], list(zip(frames, again, strict=False))
    for number, pair in enumerate(pairs):
        images, histories = zip(*(step(f, h) for f, h in zip(pair, histories, strict=True)), strict=True)
        reference, half = pair[0].reference, pair[0].reference_half
        for kind, mask in kinds(pair[0]).items() if number >= FIRST else ():
            if (share := mask.float().mean().item()) > 0:
                both = [mse_corrected(image, reference, scale, mask, reference_half=half) for image in images]
                weight = share / (len(pairs) - FIRST)
                found[kind]["error"] += weight * sum(both) / 2
                found[kind]["variance"] += weight * mse(*images, scale, mask) / 2
    return found


def tables(document: dict) -> dict[str, str]:
    """The section of docs/quality.md."""
    lines = ["| | signal | | corrected PSNR | of the error blur, in all | at edges | in textures | elsewhere |"]
    lines.append("|---" * 8 + "|")
    for row in document["rows"]:
        parts = [row[kind] for kind in KINDS]
        whole = {key: sum(part[key] for part in parts) for key in ("error", "variance")}
        shares = [f"{1 - part['variance'] / part['error']:.0%}" for part in (whole, *parts)]
        psnr = decibels(whole["error"])
        lines.append(f"| {row['sequence']} | {row['signal']} | {row['method']} | {psnr:.2f} | {' | '.join(shares)} |")
    return {"bias": "\n".join(lines)}


if __name__ == "__main__":
    main(list(zip(map(Path, sys.argv[1::2]), map(Path, sys.argv[2::2]), strict=True)))
