"""What is it worth that samples which are scattered in fog take the surface behind?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/mist --set mist --frames 8                        # likewise fog
    $render shots/mist-reference --set mist --frames 8 --samples 256 --seed 77
    python bench/diagnosis/fog.py shots/mist shots/fog

PSNR at 1 sample a pixel, of all frames but the first: with features as rendered, and with those of the surface behind.
Writes bench/results/fog.json and the table of docs/notes/fog.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.diagnosis.virtual_motion import compare, table

RESULT, PAGES = RESULTS / "fog.json", (DOCS / "notes" / "fog.md",)
FEATURES = "as rendered", "the surface behind"


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles, each with its references in the folder of its name and "-reference"."""
    how = {features: {"fog": features == FEATURES[1], "few_samples": True} for features in FEATURES}
    rows = compare(shots, "features", how)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `fog`: PSNR of each method and shot, with either features."""
    return {"fog": table(document, "features", FEATURES)}


if __name__ == "__main__":
    harness.run(main, __doc__)
