"""Does `combine` correct frames of Cycles, and never make them worse?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/glass --set glass --frames 8
    $render shots/glass-4 --set glass --frames 8 --samples 4          # likewise 16
    $render shots/glass-reference --set glass --frames 8 --samples 128 --seed 77      # likewise glass-4-reference
    python bench/combine_cycles.py shots/glass ...

Frames of two denoisers are corrected, as the commands do it: OIDN with albedo and normal filtered first, as Blender
runs it, and `denoise`. Squared error of all frames but the first, as a multiple of that before. Writes
bench/results/combine_cycles.json and a table of docs/results/combine.md.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import tyro

from bench.combine import MAX_RATIO
from bench.diagnosis.turned import pictures_of_oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.exr import write_layers
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.sequences import Sequence
from rtdenoise.metrics import mse
from rtdenoise.run.combine import combine
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import CombineOptions, Options
from rtdenoise.sanitise import sanitise

RESULT, PAGES = RESULTS / "combine_cycles.json", (DOCS / "results" / "combine.md",)
SKIP = 1  # the first frame has no history
MEAN = "**mean**"


def main(
    shots: tyro.conf.Positional[tuple[Path, ...]],
    combiners: tuple[str, ...] = ("shrinkage", "combiner"),
    levels: tuple[int, ...] = (1, 4, 16),
) -> None:
    """Measure.

    Args:
        shots: Folders of frames of 1 sample a pixel; beside them those of more samples and the references.
        combiners: Names or weights.
        levels: Samples a pixel.
    """
    rows = []
    for shot in shots:
        for spp in levels:
            noisy = f"{shot}{f'-{spp}' if spp > 1 else ''}"
            references = open_sequence(f"{noisy}-reference")
            for method, run in DENOISERS.items():
                with tempfile.TemporaryDirectory() as folder:
                    run(noisy, f"{folder}/z")
                    row = {"shot": shot.name, "spp": spp, "method": method}
                    row["estimate"] = error(f"{folder}/z", references)
                    for name in combiners:
                        combine(noisy, f"{folder}/z", f"{folder}/{name}", CombineOptions(model=name, float32=True))
                        row[Path(name).stem] = error(f"{folder}/{name}", references)
                rows.append(row)
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"max_ratio": MAX_RATIO, "rows": rows}, digits=4, pages=PAGES, tables=tables)


def by_oidn(noisy: str, out: str) -> None:
    sequence = open_sequence(noisy)
    images = pictures_of_oidn([sanitise(frame) for frame in sequence], clean=True)
    Path(out).mkdir()
    for file, image in zip(sequence.files, images, strict=True):
        write_layers(Path(out) / Path(file.path).name, {"color": image[0].permute(1, 2, 0).numpy()})


def by_denoise(noisy: str, out: str) -> None:
    denoise(noisy, out, Options(float32=True))


DENOISERS: dict[str, Callable[[str, str], None]] = {"OIDN": by_oidn, "`denoise`": by_denoise}


def error(folder: str, references: Sequence) -> float:
    """Mean squared error on the display transform."""
    images, scale = open_sequence(folder), display_exposure(references[0].radiance)
    return float(np.mean([mse(images[i].radiance, references[i].radiance, scale) for i in range(SKIP, len(images))]))


def tables(document: dict) -> dict[str, str]:
    """Section `combine-cycles`: a line for each shot and combiner, by denoiser and samples a pixel; then the means, and
    how many are above `MAX_RATIO`."""
    rows = document["rows"]
    names = [name for name in rows[0] if name not in ("shot", "spp", "method", "estimate")]
    columns = sorted({(row["method"], row["spp"]) for row in rows})
    ratios = {
        (row["shot"], name, row["method"], row["spp"]): row[name] / row["estimate"] for row in rows for name in names
    }
    shots = list(dict.fromkeys(row["shot"] for row in rows))
    lines = [
        f"| | combiner | {' | '.join(f'{method}, {spp} spp' for method, spp in columns)} | failures |",
        "|---" * (len(columns) + 3) + "|",
    ]
    for shot in (*shots, MEAN):
        for name in names:
            cells = [[ratios[one, name, *column] for one in shots if shot in (one, MEAN)] for column in columns]
            means = " | ".join(f"{np.exp(np.mean(np.log(cell))):.3f}" for cell in cells)
            failed = [ratio > document["max_ratio"] for cell in cells for ratio in cell]
            label = shot if shot == MEAN else f"`{shot}`"
            lines.append(f"| {label} | `{name}` | {means} | {sum(failed)} of {len(failed)} |")
    return {"combine-cycles": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
