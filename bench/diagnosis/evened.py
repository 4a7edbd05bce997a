"""What is it worth to leave light as it is where there is little noise?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/snow --set snow --frames 8                                    # likewise the others
    $render shots/snow-reference --set snow --frames 8 --samples 64 --seed 77
    $render shots/debris --set debris --frames 8 --width 480 --height 270       # with a reference of that size
    python bench/diagnosis/evened.py shots/{debris,isometric,...} data/standard/street ...

PSNR at 1 sample a pixel of `hybrid`, of all frames but the first: where one frame has seen a pixel, its light is evened
whatever the noise, never, and by noise as it ships. Shots of Cycles are read as `denoise` reads them; sequences with
references are taken as they are, in beauty. Writes bench/results/evened.json and the table of docs/notes/trust.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import tyro

from bench.harness.ways import compared, table
from rtdenoise.exposure import noise_level
from rtdenoise.frame import Frame
from rtdenoise.models import hybrid

RESULT, PAGES = RESULTS / "evened.json", (DOCS / "notes" / "trust.md",)
NOISES = {"always": 1e-9, "never": 1e9, "by noise": hybrid.EVENED_NOISE}  # from which on light is evened as always
WAYS = {way: {"EVENED_NOISE": noise} for way, noise in NOISES.items()}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    harness.publish(RESULT, {"rows": compared(shots, hybrid, WAYS, facts)}, digits=4, pages=PAGES, tables=tables)


def facts(frames: list[Frame]) -> dict:
    """The noise of a shot."""
    return {"noise": float(np.mean([noise_level(frame.radiance, frame.depth).item() for frame in frames]))}


def tables(document: dict) -> dict[str, str]:
    """Section `evened`: noise, and frame and uncovered, as dB more than OIDN."""
    return {"evened": table(document, "noise")}


if __name__ == "__main__":
    harness.run(main, __doc__)
