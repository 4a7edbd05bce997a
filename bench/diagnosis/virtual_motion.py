"""What is it worth that history follows what is seen in flat mirrors and through panes?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/shop --set shop --frames 8
    $render shots/shop-reference --set shop --frames 8 --samples 256 --seed 77
    python bench/diagnosis/virtual_motion.py shots/shop shots/mirror

PSNR at 1 sample a pixel, of all frames but the first: with the motion of surfaces, and of what is seen. Writes
bench/results/virtual_motion.json and the table of docs/notes/virtual_motion.md.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.diagnosis.outdated import METHODS
from bench.diagnosis.turned import errors, paired
from rtdenoise.data.opening import open_sequence
from rtdenoise.frame import Frame

RESULT, PAGES = RESULTS / "virtual_motion.json", (DOCS / "notes" / "virtual_motion.md",)
OIDN = next(iter(METHODS))
BY = "surfaces", "what is seen"


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles, each with its references in the folder of its name and "-reference"."""
    how = {motion: {"virtual_motion": motion == BY[1]} for motion in BY}
    rows = compare(shots, "motion", how, once=OIDN)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def compare(shots: tuple[Path, ...], of: str, how: dict[str, dict[str, bool]], once: str = "") -> list[dict]:
    """Rows with the PSNR of each shot and method, for each value of `of`, of frames that are read as `how` says. The
    method `once` takes the first value alone."""
    rows = []
    for shot in shots:
        frames = {value: read(shot, **flags) for value, flags in how.items()}
        for method, run in METHODS.items():
            for value in [*how][: 1 if method == once else None]:
                psnr = errors(frames[value], run(frames[value]))["frame"]
                rows.append({"shot": shot.name, "method": method, of: value, "psnr": psnr})
                print(rows[-1], flush=True)
    return rows


def read(shot: Path, **how: bool) -> list[Frame]:
    """Sanitised frames with references. `how`: fields of `Sequence`."""
    noisy = replace(open_sequence(shot), soft_edges=True, **how)
    return paired(noisy, f"{shot}-reference")


def tables(document: dict) -> dict[str, str]:
    """Section `virtual-motion`: PSNR of each method and shot, with either motion."""
    return {"virtual-motion": table(document, "motion", BY)}


def table(document: dict, of: str, values: tuple[str, ...]) -> str:
    """PSNR of each method and shot, for each value that `of` has there."""
    found = {(row["shot"], row["method"], row[of]): row["psnr"] for row in document["rows"]}
    shots = list(dict.fromkeys(shot for shot, _, _ in found))
    lines = [f"| | {' | '.join(shots)} |", "|---" * (len(shots) + 1) + "|"]
    for method in dict.fromkeys(method for _, method, _ in found):
        cells = [[found[key] for value in values if (key := (shot, method, value)) in found] for shot in shots]
        lines.append(f"| {method} | {' | '.join(' → '.join(f'{x:.2f}' for x in cell) for cell in cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    harness.run(main, __doc__)
