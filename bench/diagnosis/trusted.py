"""What is it worth to trust the kernels' picture where history gives way?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/flag --set flag --frames 8                                # likewise the others
    $render shots/flag-reference --set flag --frames 8 --samples 64 --seed 77
    python bench/diagnosis/trusted.py shots/{flag,turntable,...} data/standard/street ...

PSNR at 1 sample a pixel of `hybrid`, of all frames but the first: where surfaces turn and light changes it trusts
history not at all, half, as it ships, or as the network says. Writes bench/results/trusted.json and the table of
docs/notes/turned.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.harness.ways import compared, table
from rtdenoise.models.accumulated_kpn import Kernels

RESULT, PAGES = RESULTS / "trusted.json", (DOCS / "notes" / "turned.md",)
WAYS = {
    "not at all": {"trust": property(lambda its: 1 - its.past.held * (1 - (1 - its.reset) * its.past.stays))},
    "half": {"trust": Kernels.trust},
    "as the network says": {"trust": property(lambda its: 1 - its.past.held * its.reset)},
}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    harness.publish(RESULT, {"rows": compared(shots, Kernels, WAYS)}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `trusted`: frame and uncovered, as dB more than OIDN."""
    return {"trusted": table(document)}


if __name__ == "__main__":
    harness.run(main, __doc__)
