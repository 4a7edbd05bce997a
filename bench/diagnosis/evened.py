"""What is it worth to leave light as it is where there is little noise?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/snow --set snow --frames 8                                    # likewise the others
    $render shots/snow-reference --set snow --frames 8 --samples 64 --seed 77
    $render shots/debris --set debris --frames 8 --width 480 --height 270       # with a reference of that size
    python bench/diagnosis/evened.py shots/{debris,isometric,...} data/standard/street ...

PSNR at 1 sample a pixel of `hybrid`, of all frames but the first: where one frame has seen a pixel, its light is evened
whatever the noise, never, and by noise as it ships. Shots of Cycles are read as `denoise` reads them; sequences with
references are taken as they are, in beauty. Writes bench/results/evened.json and the table of docs/notes/trust.md.
"""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import tyro

from bench.diagnosis.turned import errors, paired, pictures, pictures_of_oidn, with_references
from rtdenoise.exposure import noise_level
from rtdenoise.frame import Frame
from rtdenoise.models import hybrid
from rtdenoise.run.choice import open_chosen
from rtdenoise.run.options import Options

RESULT, PAGES = RESULTS / "evened.json", (DOCS / "notes" / "trust.md",)
WAYS = {"always": 1e-9, "never": 1e9, "by noise": hybrid.EVENED_NOISE}  # and the noise from which on it is as always
MODES = {"in real time": 0, "two frames ahead": 2}


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    rows = []
    for shot in shots:
        frames = read(shot)
        noise = float(np.mean([noise_level(frame.radiance, frame.depth).item() for frame in frames]))
        told = {"shot": shot.name, "noise": noise}
        rows.append(told | {"method": "OIDN"} | errors(frames, pictures_of_oidn(frames)))
        for mode, ahead in MODES.items():
            for way, constant in WAYS.items():
                with patch.object(hybrid, "EVENED_NOISE", constant):
                    found = errors(frames, pictures(frames, "hybrid", ahead))
                rows.append(told | {"method": mode, "evened": way} | found)
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def read(shot: Path) -> list[Frame]:
    if not Path(f"{shot}-reference").is_dir():
        return with_references(shot, "color")
    return paired(open_chosen(str(shot), Options())[0], f"{shot}-reference")


def tables(document: dict) -> dict[str, str]:
    """Section `evened`: frame and uncovered, as dB more than OIDN."""
    found = {(row["shot"], row["method"], row.get("evened")): row for row in document["rows"]}
    keys = [(mode, way) for mode in MODES for way in WAYS]
    lines = [f"| | noise | {' | '.join(f'{mode}, {way}' for mode, way in keys)} |", "|---" * (len(keys) + 2) + "|"]
    for shot in dict.fromkeys(shot for shot, *_ in found):
        peer = found[shot, "OIDN", None]
        cells = [", ".join(f"{row[x] - peer[x]:+.2f}" for x in ("frame", "uncovered") if peer[x] is not None)
                 for row in (found[shot, *key] for key in keys)]  # fmt: skip
        lines.append(f"| `{shot}` | {peer['noise']:.2f} | {' | '.join(cells)} |")
    return {"evened": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
