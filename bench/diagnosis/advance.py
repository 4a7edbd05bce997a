"""What is it worth that history goes ahead with the camera?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/vertigo --set vertigo --frames 8                                # likewise the others
    $render shots/vertigo-reference --set vertigo --frames 8 --samples 64 --seed 77
    python bench/diagnosis/advance.py shots/{vertigo,tiles,...} data/standard/street

PSNR at 1 sample a pixel of `hybrid`, of all frames but the first: depths of the frame before as they are, and as from
this frame's camera. Writes bench/results/advance.json and the table of docs/notes/advance.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro
from torch import Tensor

from bench.harness.ways import compared, table
from rtdenoise import history
from rtdenoise.frame import Frame

RESULT, PAGES = RESULTS / "advance.json", (DOCS / "notes" / "advance.md",)


def stands(frame: Frame, depth: Tensor, normal: Tensor) -> Tensor:
    return frame.depth.new_zeros(len(frame.depth), 1, 1, 1)


WAYS = {"as they are": {"advance": stands}, "as from this camera": {"advance": history.advance}}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    harness.publish(RESULT, {"rows": compared(shots, history, WAYS)}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `advance`: frame and uncovered, as dB more than OIDN."""
    return {"advance": table(document)}


if __name__ == "__main__":
    harness.run(main, __doc__)
