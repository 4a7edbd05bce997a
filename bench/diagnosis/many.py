"""How good are frames of Cycles at 4 and 16 samples a pixel, beside OIDN with albedo and normal filtered first?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/meadow-16 --set meadow --frames 6 --samples 16
    $render shots/meadow-reference --set meadow --frames 6 --samples 192 --seed 77
    $render shots/meadow-reference-2 --set meadow --frames 6 --samples 64 --seed 78
    python bench/diagnosis/many.py shots/{turntable,meadow,still-life,ocean,glass,pool,room}-{4,16}

Corrected PSNR of all frames but the first, read as `denoise` reads them. Writes bench/results/many.json and the table
of docs/notes/many.md.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro
from torch import Tensor

from bench.diagnosis.outdated import singles
from bench.diagnosis.turned import errors, paired, pictures, pictures_of_oidn
from rtdenoise.frame import Frame
from rtdenoise.models import HybridConfig, footprint
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

RESULT, PAGES = RESULTS / "many.json", (DOCS / "notes" / "many.md",)
METHODS = {
    "OIDN": pictures_of_oidn,
    "OIDN, albedo and normal filtered first": lambda frames: pictures_of_oidn(frames, clean=True),
    "`hybrid-many`": lambda frames: pictures(frames, "hybrid-many", 0),
    "`hybrid-many` with `--lookahead 2`": lambda frames: pictures(frames, "hybrid-many", 2),
    "`hybrid-large-many`, single frames, kernels everywhere": lambda frames: before(singles, frames),
    "`hybrid-large-many`, single frames": lambda frames: singles(frames, "hybrid-large-many"),
    "`hybrid-large-many` with `--lookahead 2`, as before": lambda frames: before(pictures, frames, 2),
    "`hybrid-large-many` with `--lookahead 2`": lambda frames: pictures(frames, "hybrid-large-many", 2),
    "**`hybrid-large-many` with `--lookahead 3`**": lambda frames: pictures(frames, "hybrid-large-many", 3),
}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles, NAME-SAMPLES, each with its references in NAME-reference beside it."""
    rows = []
    for shot in shots:
        name, _, samples = shot.name.rpartition("-")
        frames = read(shot, shot.with_name(f"{name}-reference"))
        for method, run in METHODS.items():
            psnr = errors(frames, run(frames))["frame"]
            rows.append({"shot": name, "samples": int(samples), "method": method, "psnr": psnr})
            print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def before(run: Callable, frames: list[Frame], *ahead: int) -> list[Tensor]:
    """Pictures of `hybrid-large-many` with kernels also where no history is, and with the whole reset."""
    share, footprint.RESET_MORE = footprint.RESET_MORE, 1.0
    needs, HybridConfig.kernels_need_history = HybridConfig.kernels_need_history, False
    try:
        return run(frames, "hybrid-large-many", *ahead)
    finally:
        footprint.RESET_MORE, HybridConfig.kernels_need_history = share, needs


def read(shot: Path, references: Path) -> list[Frame]:
    """Sanitised frames with references."""
    noisy, _, _ = open_chosen(str(shot), Options(model="hybrid-many"))
    return paired(noisy, references)


def tables(document: dict) -> dict[str, str]:
    """Section `many`: PSNR of each shot and method, at each number of samples."""
    found = {(row["shot"], row["method"], row["samples"]): row["psnr"] for row in document["rows"]}
    shots, counts = ({key[i]: None for key in found} for i in (0, 2))
    lines = [f"| samples | | {' | '.join(shots)} |", "|---" * (len(shots) + 2) + "|"]
    for count in sorted(counts):
        for method in METHODS:
            lines.append(f"| {count} | {method} | {' | '.join(f'{found[s, method, count]:.2f}' for s in shots)} |")
    return {"many": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
