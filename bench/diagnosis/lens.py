"""What is it worth to give motion vectors the zoom that they lack?

    render="bpyenv/bin/python examples/blender/render.py"           # Blender 4.2
    $render shots/zoom --set zoom --frames 8
    $render shots/zoom-reference --set zoom --frames 8 --samples 256 --seed 77
    python bench/diagnosis/lens.py shots/zoom

PSNR at 1 sample a pixel, of all frames but the first: vectors as they are, and with `--lens`. Writes
bench/results/lens.json and the table of docs/use/motion.md.
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
from bench.diagnosis.turned import errors, with_references
from rtdenoise.data.opening import open_sequence
from rtdenoise.run.lens_motion import with_lens
from rtdenoise.sanitise import sanitise

RESULT, PAGES = RESULTS / "lens.json", (DOCS / "use" / "motion.md",)
COMPARED = [method for method in METHODS if method not in ("`default`", "`hybrid-large`")]


def main(shot: tyro.conf.Positional[Path]) -> None:
    frames = with_references(shot, "color")
    moved = [sanitise(frame) for frame in with_lens(open_sequence(shot))]
    lens = [replace(a, motion=b.motion, motion_next=None) for a, b in zip(frames, moved, strict=True)]
    rows = []
    for method in COMPARED:
        run = METHODS[method]
        psnr = {name: errors(seen, run(seen))["frame"] for name, seen in (("as they are", frames), ("--lens", lens))}
        rows.append({"sequence": shot.name, "method": method} | psnr)
        print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `lens`: PSNR of each method."""
    lines = ["| | vectors as they are | with `--lens` |", "|---|---|---|"]
    lines += [f"| {row['method']} | {row['as they are']:.1f} dB | {row['--lens']:.1f} dB |" for row in document["rows"]]
    return {"lens": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
