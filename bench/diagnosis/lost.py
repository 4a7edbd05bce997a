"""What is it worth that albedo of lost samples is that of those around?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/ocean --set ocean --frames 8                      # likewise pool, glass
    $render shots/ocean-reference --set ocean --frames 8 --samples 256 --seed 77
    python bench/diagnosis/lost.py shots/{ocean,pool,glass}

PSNR at 1 sample a pixel, of all frames but the first: with albedo as rendered, and where samples were lost with that of
those around. Writes bench/results/lost.json and the table of docs/notes/lost.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.diagnosis.virtual_motion import compare, table

RESULT, PAGES = RESULTS / "lost.json", (DOCS / "notes" / "lost.md",)
ALBEDO = "as rendered", "of those around"


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles, each with its references in the folder of its name and "-reference"."""
    how = {albedo: {"virtual_motion": True, "lost_samples": albedo == ALBEDO[1]} for albedo in ALBEDO}
    rows = compare(shots, "albedo", how)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `lost`: PSNR of each method and shot, with either albedo."""
    return {"lost": table(document, "albedo", ALBEDO)}


if __name__ == "__main__":
    harness.run(main, __doc__)
