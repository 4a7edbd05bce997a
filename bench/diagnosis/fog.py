"""What is it worth that samples which are scattered in fog take the surface behind?

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/mist --set mist --frames 8                        # likewise fog
    $render shots/mist-reference --set mist --frames 8 --samples 256 --seed 77
    python bench/diagnosis/fog.py shots/mist shots/fog

PSNR at 1 sample a pixel, of all frames but the first: with features as rendered, and with those of the surface behind.
Writes bench/results/fog.json and the table of docs/notes/fog.md.
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
from bench.diagnosis.turned import errors
from rtdenoise.data.sequences import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.sanitise import sanitise

RESULT, PAGES = RESULTS / "fog.json", (DOCS / "notes" / "fog.md",)
FEATURES = "as rendered", "the surface behind"


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles, each with its references in the folder of its name and "-reference"."""
    rows = []
    for shot in shots:
        frames = {features: read(shot, features == FEATURES[1]) for features in FEATURES}
        for method, run in METHODS.items():
            for features in FEATURES:
                psnr = errors(frames[features], run(frames[features]))["frame"]
                rows.append({"shot": shot.name, "method": method, "features": features, "psnr": psnr})
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def read(shot: Path, behind: bool) -> list[Frame]:
    """Sanitised frames with references."""
    noisy = replace(open_sequence(shot), soft_edges=True, fog=behind, few_samples=True)
    pairs = zip(noisy, open_sequence(f"{shot}-reference"), strict=True)
    return [replace(sanitise(frame), reference=truth.radiance) for frame, truth in pairs]


def tables(document: dict) -> dict[str, str]:
    """Section `fog`: PSNR of each method and shot, with either features."""
    found = {(row["shot"], row["method"], row["features"]): row["psnr"] for row in document["rows"]}
    shots = list(dict.fromkeys(shot for shot, _, _ in found))
    lines = [f"| | {' | '.join(shots)} |", "|---" * (len(shots) + 1) + "|"]
    for method in dict.fromkeys(method for _, method, _ in found):
        cells = [" → ".join(f"{found[shot, method, features]:.2f}" for features in FEATURES) for shot in shots]
        lines.append(f"| {method} | {' | '.join(cells)} |")
    return {"fog": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
