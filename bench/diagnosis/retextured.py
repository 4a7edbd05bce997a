"""What is it worth that history gives way to textures too fine for the pixels around to tell that they have moved?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/ticker --set ticker --frames 8                                # likewise the others
    $render shots/ticker-reference --set ticker --frames 8 --samples 64 --seed 77
    python bench/diagnosis/retextured.py shots/{ticker,macro,...}

PSNR at 1 sample a pixel of `hybrid`, of all frames but the first: as `ops.retextured` is, and without asking whether
albedo before is farther away than that of neighbours. Writes bench/results/retextured_fine.json and the table of
docs/notes/retextured.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.harness.ways import compared, table
from rtdenoise.ops.native import retextured

RESULT, PAGES = RESULTS / "retextured_fine.json", (DOCS / "notes" / "retextured.md",)
BOUNDS = {  # of the op in C
    "not asked": {"MOVED_LEAST": 1e8, "MOVED_MOST": 1e9},
    "asked": {"MOVED_LEAST": retextured.MOVED_LEAST, "MOVED_MOST": retextured.MOVED_MOST},
}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = compared(shots, retextured, BOUNDS)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `retextured`: frame and uncovered, as dB more than OIDN."""
    return {"retextured": table(document)}


if __name__ == "__main__":
    harness.run(main, __doc__)
