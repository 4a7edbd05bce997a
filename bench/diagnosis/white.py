"""What is it worth to ask whether differences between frames are white, as noise is?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/evening --set evening --frames 8                              # likewise the others
    $render shots/evening-reference --set evening --frames 8 --samples 64 --seed 77
    $render shots/debris --set debris --frames 8 --width 480 --height 270       # with a reference of that size
    python bench/diagnosis/white.py shots/{evening,debris,...} data/standard/street ...

PSNR at 1 sample a pixel of `hybrid`, of all frames but the first: history that `ops.recall.white` has not tested, and
that it has. Shots of Cycles are read as `denoise` reads them; of sequences with references beauty is taken. Writes
bench/results/white.json and the table of docs/notes/recall.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.harness.ways import compared, table
from rtdenoise.ops.native import recall

RESULT, PAGES = RESULTS / "white.json", (DOCS / "notes" / "recall.md",)
BOUNDS = {  # of the op in C
    "not asked": {"RECALL_WHITE": 1e8, "RECALL_JOINED": 1e9},
    "asked": {"RECALL_WHITE": recall.RECALL_WHITE, "RECALL_JOINED": recall.RECALL_JOINED},
}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    harness.publish(RESULT, {"rows": compared(shots, recall, BOUNDS)}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `white`: frame and uncovered, as dB more than OIDN."""
    return {"white": table(document)}


if __name__ == "__main__":
    harness.run(main, __doc__)
