"""What is it worth that what is out of focus counts wherever it was hit?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/portrait --set portrait --frames 8                # likewise focus-pull, macro
    $render shots/portrait-reference --set portrait --frames 8 --samples 256 --seed 77
    python bench/diagnosis/scattered.py shots/{portrait,focus-pull,macro}

At 1 sample a pixel, of all frames but the first, with surfaces that are tested beside a pixel alone, and with
`ops.scattered`: PSNR, and the light of bright blurred lamps as a share of the reference's. Writes
bench/results/scattered.json and the table of docs/notes/scattered.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
import tyro
from torch import Tensor
from torch.nn import functional as F

from bench.diagnosis.outdated import METHODS
from bench.diagnosis.turned import SKIP, errors
from bench.diagnosis.virtual_motion import OIDN, read
from rtdenoise.frame import Frame
from rtdenoise.models import past, shrinkage

RESULT, PAGES = RESULTS / "scattered.json", (DOCS / "notes" / "scattered.md",)
ALONE = OIDN, "`hybrid`, single frames"  # what has no history
BESIDE, WITH = "beside", "and scattered"
LAMP, AROUND = 2.0, 9  # light from which on it is a lamp's; side in pixels of what belongs to it


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles, each with its references in the folder of its name and "-reference"."""
    rows = []
    for shot in shots:
        frames = read(shot, virtual_motion=True)
        for method, run in METHODS.items():
            for tested in (WITH,) if method in ALONE else (BESIDE, WITH):
                with nothing_scattered(tested == BESIDE):
                    images = run(frames)
                found = {"psnr": errors(frames, images)["frame"], "lamps": light_of_lamps(frames, images)}
                rows.append({"shot": shot.name, "method": method, "tested": tested, **found})
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


@contextmanager
def nothing_scattered(so: bool) -> Iterator[None]:
    """Surfaces count beside a pixel alone, if `so`."""
    use = past.scattered
    if so:
        past.scattered = shrinkage.scattered = lambda depth: torch.cat([1 + 0 * depth, 0 * depth], dim=1)
    try:
        yield
    finally:
        past.scattered = shrinkage.scattered = use


def light_of_lamps(frames: list[Frame], images: list[Tensor]) -> float | None:
    """Light around all that is brighter than LAMP, as a share of the reference's; None where there is nothing."""
    shown = known = 0.0
    for frame, image in [*zip(frames, images, strict=True)][SKIP:]:
        lamp = (frame.reference.amax(1, keepdim=True) > LAMP).to(image.dtype)
        lamp = F.max_pool2d(lamp, AROUND, 1, AROUND // 2)
        shown, known = shown + (lamp * image).sum().item(), known + (lamp * frame.reference).sum().item()
    return shown / known if known else None


def tables(document: dict) -> dict[str, str]:
    """Section `scattered`: PSNR and light of lamps of each method and shot, without and with."""
    found = {(row["shot"], row["method"], row["tested"]): row for row in document["rows"]}
    shots = list(dict.fromkeys(shot for shot, _, _ in found))
    lines = [f"| | {' | '.join(f'{shot} | light of lamps' for shot in shots)} |", "|---" * (2 * len(shots) + 1) + "|"]
    for method in dict.fromkeys(method for _, method, _ in found):
        cells = []
        for shot in shots:
            both = [found[key] for tested in (BESIDE, WITH) if (key := (shot, method, tested)) in found]
            cells.append(" → ".join(f"{row['psnr']:.2f}" for row in both))
            cells.append(" → ".join("–" if row["lamps"] is None else f"{row['lamps']:.2f}" for row in both))
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return {"scattered": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
