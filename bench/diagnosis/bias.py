"""Is the error noise or blur? Variance and squared bias of the output, from two renderings of the same frames.

python bench/diagnosis/bias.py SEQUENCE AGAIN [SEQUENCE AGAIN ...]

The two renderings of a pair differ in their samples alone (`rtdenoise render --seed`). Half the mean squared difference
of a denoiser's outputs is its variance. The rest of its corrected error (`metrics.image.mse_corrected`) is squared
bias, which no averaging of runs removes: blur. Split by kind of pixel as in `where.py`. Writes bench/results/bias.json
and the table of docs/results/quality.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness
from bench.diagnosis.where import KINDS, kinds

# isort: split
import torch
import tyro

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.evaluate.inputs import Source
from rtdenoise.frame import Frame
from rtdenoise.metrics.image import decibels, mse, mse_corrected
from rtdenoise.models import load

RESULT, PAGES = RESULTS / "bias.json", (DOCS / "results" / "quality.md",)
MODELS = ("fast", "default", "hybrid")
FIRST = 4  # frames before this one are not counted: their histories are short


def main(
    sequence: tyro.conf.Positional[Path],
    again: tyro.conf.Positional[Path],
    more: tyro.conf.Positional[tuple[tuple[Path, Path], ...]] = (),
) -> None:
    steps = {"oidn": Oidn().step} | {name: load(name, precision="fp32").step for name in MODELS}
    rows = []
    for folder, rendered_again in [(sequence, again), *more]:
        for signal in ("indirect", "color"):
            source = Source.open(folder, signal, "auto", None)
            frames = source.frames(source.spp)
            if frames[0].reference_half is None:
                continue
            for name, step in steps.items():
                found = errors(frames, list(open_sequence(rendered_again, signal=signal)), step)
                rows.append({"sequence": source.name, "signal": signal, "method": name} | found)
                print(rows[-1])
    harness.publish(RESULT, {"rows": rows}, digits=5, pages=PAGES, tables=tables)


@torch.inference_mode()
def errors(frames: list[Frame], again: list[Frame], step) -> dict[str, dict[str, float]]:
    """Kind of pixel -> its parts of the mean corrected 'error' and of the mean 'variance'."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    found = {kind: {"error": 0.0, "variance": 0.0} for kind in KINDS}
    pairs = zip(harness.denoise(step, frames), harness.denoise(step, again), strict=False)
    settled = list(zip(frames, pairs, strict=False))[FIRST:]
    for frame, images in settled:
        for kind, mask in kinds(frame).items():
            if (share := mask.float().mean().item()) > 0:
                both = [
                    mse_corrected(image, frame.reference, scale, mask, reference_half=frame.reference_half)
                    for image in images
                ]
                weight = share / len(settled)
                found[kind]["error"] += weight * sum(both) / 2
                found[kind]["variance"] += weight * mse(*images, scale, mask) / 2
    return found


def tables(document: dict) -> dict[str, str]:
    """Section `bias`: corrected PSNR, and the share of blur in the error by kind of pixel."""
    lines = ["| | signal | | corrected PSNR | of the error blur, in all | at edges | in textures | elsewhere |"]
    lines.append("|---" * 8 + "|")
    for row in (row for row in document["rows"] if row["method"] in ("oidn", *MODELS)):
        parts = [row[kind] for kind in KINDS]
        whole = {key: sum(part[key] for part in parts) for key in ("error", "variance")}
        shares = [f"{1 - part['variance'] / part['error']:.0%}" for part in (whole, *parts)]
        psnr = decibels(whole["error"])
        lines.append(f"| {row['sequence']} | {row['signal']} | {row['method']} | {psnr:.2f} | {' | '.join(shares)} |")
    return {"bias": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
