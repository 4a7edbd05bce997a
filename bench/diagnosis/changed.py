"""What is it worth to leave light as it is where it has changed, beside light that stays?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/slides --set slides --frames 8                                # likewise the others
    $render shots/slides-reference --set slides --frames 8 --samples 64 --seed 77
    python bench/diagnosis/changed.py shots/{slides,disco,...} data/standard/street ...

PSNR at 1 sample a pixel of `hybrid`, of all frames but the first: light that one frame has seen is evened whether or
not history gives way, and as far as it does not. Writes bench/results/evened_changed.json and the table of
docs/notes/trust.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.harness.ways import compared, table
from rtdenoise.models.past import Past

RESULT, PAGES = RESULTS / "evened_changed.json", (DOCS / "notes" / "trust.md",)
WAYS = {"evened in any case": {"stays": 1.0}, "as far as history stays": {"stays": Past.stays}}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    harness.publish(RESULT, {"rows": compared(shots, Past, WAYS)}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `changed`: frame and uncovered, as dB more than OIDN."""
    return {"changed": table(document)}


if __name__ == "__main__":
    harness.run(main, __doc__)
