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

import math
import sys
from pathlib import Path
from types import ModuleType
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.diagnosis.evened import MODES, read
from bench.diagnosis.outdated import singles
from bench.diagnosis.turned import errors, pictures, pictures_of_oidn
from rtdenoise.ops.native import recall

RESULT, PAGES = RESULTS / "white.json", (DOCS / "notes" / "recall.md",)
BOUNDS = {  # of the op in C
    "not asked": {"RECALL_WHITE": 1e8, "RECALL_JOINED": 1e9},
    "asked": {"RECALL_WHITE": recall.RECALL_WHITE, "RECALL_JOINED": recall.RECALL_JOINED},
}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    harness.publish(RESULT, {"rows": compared(shots, recall, BOUNDS)}, digits=4, pages=PAGES, tables=tables)


def compared(shots: tuple[Path, ...], part: ModuleType | type, ways: dict[str, dict]) -> list[dict]:
    """Errors of OIDN and of `hybrid`, with each of these values of names of a part."""
    rows = []
    for shot in shots:
        frames = read(shot)
        single = {"shot": shot.name, "way": "single frames"}
        rows.append({"shot": shot.name, "method": "OIDN"} | errors(frames, pictures_of_oidn(frames)))
        rows.append(single | {"method": "hybrid"} | errors(frames, singles(frames, "hybrid")))
        for mode, ahead in MODES.items():
            for told, values in ways.items():
                with patch.multiple(part, **values):
                    found = errors(frames, pictures(frames, "hybrid", ahead))
                rows.append({"shot": shot.name, "method": mode, "way": told} | found)
                print(rows[-1], flush=True)
    return rows


def tables(document: dict) -> dict[str, str]:
    """Section `white`: frame and uncovered, as dB more than OIDN."""
    return {"white": table(document)}


def table(document: dict) -> str:
    """What was `compared`: frame and uncovered, as dB more than OIDN."""
    found = {(row["shot"], row["method"], row.get("way")): row for row in document["rows"]}
    keys = [key for key in dict.fromkeys((method, way) for _, method, way in found) if key[0] != "OIDN"]
    names = [way if method == "hybrid" else f"{method}, {way}" for method, way in keys]
    lines = [f"| | {' | '.join(names)} |", "|---" * (len(keys) + 1) + "|"]
    for shot in dict.fromkeys(shot for shot, *_ in found):
        peer = found[shot, "OIDN", None]
        regions = [x for x in ("frame", "uncovered") if peer[x] is not None and math.isfinite(peer[x])]
        cells = [", ".join(f"{found[shot, *key][x] - peer[x]:+.2f}" for x in regions) for key in keys]
        lines.append(f"| `{shot}` | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    harness.run(main, __doc__)
