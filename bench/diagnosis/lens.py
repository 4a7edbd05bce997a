"""What is it worth to give motion vectors the zoom that they lack?

    render="bpyenv/bin/python examples/blender/render.py"           # Blender 4.2
    $render shots/zoom --set zoom --frames 8                        # likewise shots/zoom-5, with Blender 5
    $render shots/zoom-reference --set zoom --frames 8 --samples 256 --seed 77
    cp -r shots/zoom-reference shots/zoom-5-reference
    python bench/diagnosis/lens.py shots/zoom shots/zoom-5

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
from torch import Tensor

from bench.diagnosis.outdated import offline, singles
from bench.diagnosis.turned import errors, pictures, pictures_of_oidn, with_references
from rtdenoise.data.sequences import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.run.lens_motion import with_lens
from rtdenoise.sanitise import sanitise

RESULT, PAGES = RESULTS / "lens.json", (DOCS / "use" / "motion.md",)
HEADS = {"zoom": "vectors of Blender 4.2", "zoom-5": "of Blender 5, which know the zoom"}
AS_IS, LENS = "", ", `--lens`"


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for folder in sequences:
        frames = with_references(folder, "color")
        moved = [sanitise(frame) for frame in with_lens(open_sequence(folder))]
        lens = [replace(a, motion=b.motion, motion_next=None) for a, b in zip(frames, moved, strict=True)]

        def add(method: str, images: list[Tensor], frames: list[Frame] = frames, name: str = folder.name) -> None:
            rows.append({"sequence": name, "method": method} | errors(frames, images))
            print(rows[-1], flush=True)

        add("OIDN, albedo and normal filtered first", pictures_of_oidn(frames, clean=True))
        add("`hybrid`, single frames", singles(frames, "hybrid"))
        for label, seen in ((AS_IS, frames), (LENS, lens)):
            add(f"`hybrid`{label}", pictures(seen, "hybrid", 0))
            add(f"`hybrid` with `--lookahead 2`{label}", pictures(seen, "hybrid", 2))
            add(f"`--offline`{label}", offline(seen))
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `lens`: PSNR of each method on each shot."""
    rows = document["rows"]
    names, methods = (list(dict.fromkeys(row[key] for row in rows)) for key in ("sequence", "method"))
    found = {(row["sequence"], row["method"]): row["frame"] for row in rows}
    lines = [f"| | {' | '.join(HEADS[name] for name in names)} |", "|---" * (len(names) + 1) + "|"]
    lines += [f"| {method} | {' | '.join(f'{found[name, method]:.1f} dB' for name in names)} |" for method in methods]
    return {"lens": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
