"""What is it worth that history follows light which changes as a whole?

    python bench/diagnosis/exposure.py shots/{still-life,room,evening} data/standard/{street,window,bathroom}

Sequences with references, or a folder of these beside each ("-reference"). Frames and what noise they have are
multiplied by curves that an animated exposure, or lamps that dim together, would give them. PSNR at 1 sample a pixel
of pictures divided by the curve, of all frames but the first: with history as it is, and with history that follows.
Writes bench/results/exposure.json and the table of docs/notes/exposure.md.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import tyro
from torch import Tensor

from bench.diagnosis.outdated import METHODS
from bench.diagnosis.turned import errors, with_references
from rtdenoise.brightness import followed
from rtdenoise.frame import Frame

RESULT, PAGES = RESULTS / "exposure.json", (DOCS / "notes" / "exposure.md",)
FRAMES = 10
CURVES = {
    "steady": lambda i: 1.0,
    "-8 % a frame": lambda i: 0.92**i,
    "a fade, -10 % of the first": lambda i: 1 - 0.1 * i,
    "±15 %, to and fro": lambda i: 1 + 0.15 * math.sin(2.4 * i),
    "twice as bright at once": lambda i: 1.0 if i < 4 else 2.0,
}
COMPARED = "`default`", "`hybrid`", "`hybrid` with `--lookahead 2`", "`--offline`"
ALONE = "`hybrid`, single frames"
LONG = {"`--offline`": ("steady", "-8 % a frame")}  # what takes long, with these alone
AS_IT_IS, FOLLOWS = "as it is", "follows"


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for folder in sequences:
        steady = with_references(folder, "color")[:FRAMES]
        alone = errors(steady, METHODS[ALONE](steady))["frame"]
        rows.append({"sequence": folder.name, "method": ALONE, "curve": "steady", AS_IT_IS: alone})
        for curve, gain in CURVES.items():
            gains = [gain(i) for i in range(len(steady))]
            frames = [frame.divided(1 / g) for frame, g in zip(steady, gains, strict=True)]
            for method in COMPARED:
                if curve not in LONG.get(method, CURVES):
                    continue
                run, psnr = METHODS[method], {}
                for kind, images in ((AS_IT_IS, run(frames)), (FOLLOWS, following(frames, run))):
                    psnr[kind] = errors(steady, [x / g for x, g in zip(images, gains, strict=True)])["frame"]
                rows.append({"sequence": folder.name, "method": method, "curve": curve} | psnr)
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def following(frames: list[Frame], run: Callable[[list[Frame]], list[Tensor]]) -> list[Tensor]:
    """Pictures of frames that are denoised divided by their brightness, as `rtdenoise denoise` does."""
    found = []
    for frame in frames:
        found.append(followed(frame, found[-1] if found else None))
    divided = [b.divided(f) for f, b in zip(frames, found, strict=True)]
    return [image * b.gain for image, b in zip(run(divided), found, strict=True)]


def tables(document: dict) -> dict[str, str]:
    """Section `exposure`: PSNR of each method and curve, history as it is → history that follows, mean over sequences
    and each sequence."""
    rows = document["rows"]
    names = list(dict.fromkeys(row["sequence"] for row in rows))
    lines = [f"| | | mean | {' | '.join(names)} |", "|---" * (len(names) + 3) + "|"]
    for method, curve in dict.fromkeys((row["method"], row["curve"]) for row in rows):
        mine = [row for row in rows if (row["method"], row["curve"]) == (method, curve)]
        kinds = [kind for kind in (AS_IT_IS, FOLLOWS) if kind in mine[0]]
        cells = [" → ".join(f"{np.mean([row[kind] for row in mine]):.2f}" for kind in kinds)]
        cells += [" → ".join(f"{row[kind]:.2f}" for kind in kinds) for row in mine]
        lines.append(f"| {method} | {curve} | {' | '.join(cells)} |")
    return {"exposure": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
