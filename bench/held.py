"""Weights against OIDN on scenes held out of training: single frames and later ones, at several sample counts.

python bench/held.py HELD... --weights default quality runs/mine/weights.safetensors

HELD/spp01, HELD/spp04 ... hold the same clips at several sample counts (`combine_clips.py --held-out`), with references
of independent samples in two halves. PSNR is corrected for the references' own noise, and taken at the display exposure
and three stops to either side of it: dark pictures show deep shadows, bright ones what glows. This is the figure that
steers training; `quality.py` has all metrics. Writes bench/results/held.json and tables of docs/results/held.md.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.metrics.image import decibels, mse_corrected
from rtdenoise.models import load

RESULT, PAGES = RESULTS / "held.json", (DOCS / "results" / "held.md",)
SIGNALS = ("indirect", "color")
LEVELS = (1, 4, 16, 64)
STOPS = (0, 3, -3)  # exposures of the measure
LATER = 3  # frames at the end of a clip that count as later ones
LEAST = 1e-7  # squared error that a logarithm is taken of


def main(
    held: tyro.conf.Positional[tuple[Path, ...]],
    weights: tuple[str, ...] = ("fast", "default", "quality"),
    levels: tuple[int, ...] = LEVELS,
    write: bool = True,
) -> None:
    """Measure.

    Args:
        held: Folders with a folder of clips for each sample count.
        weights: Names of shipped weights, or files.
        levels: Sample counts.
        write: Write the JSON and the tables; off: only print them.
    """
    rows = [row for folder in held for level in levels for row in measured(folder, level, weights)]
    document = {"weights": list(weights), "levels": list(levels), "rows": rows}
    for section in tables(document).values():
        print(section, end="\n\n")
    if write:
        harness.publish(RESULT, document, digits=4, pages=PAGES, tables=tables)


@torch.inference_mode()
def measured(folder: Path, level: int, weights: tuple[str, ...]) -> Iterator[dict]:
    """A row for every clip, signal and method: corrected PSNR of single and of later frames, by exposure."""
    clips = ClipDataset(folder / f"spp{level:02d}")
    methods = {"oidn": Oidn()} | {name: load(name, precision="fp32") for name in weights}
    for index, signal in ((i, s) for i in range(len(clips)) for s in SIGNALS):
        frames = clips.load(index, signal=signal)
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for name, method in methods.items():
            errors, history = defaultdict(list), None
            for number, frame in enumerate(frames):
                image, history = method.step(frame, history)
                kind = "single" if number == 0 else "later" if number >= len(frames) - LATER else "between"
                for stops in STOPS:
                    exposed = mse_corrected(
                        image, frame.reference, scale * 2.0**stops, reference_half=frame.reference_half
                    )
                    errors[kind, stops].append(exposed)
            yield {
                "clip": f"{folder.name}/{clips.facts(index)['place']}", "signal": signal, "spp": level, "method": name,
                "psnr": {f"{kind} {stops:+d}": decibels(max(LEAST, float(np.mean(errors[kind, stops]))))
                         for kind in ("single", "later") for stops in STOPS},
            }  # fmt: skip


def tables(document: dict) -> dict[str, str]:
    """Sections `held` (leads over OIDN), `held-clips` (at 1 spp, clip by clip) and `held-exposures` (at 1 spp)."""
    cells = {
        (row["method"], row["spp"], row["signal"], row["clip"]): row["psnr"] for row in document["rows"]
    }  # fmt: skip
    clips = list(dict.fromkeys(row["clip"] for row in document["rows"]))

    def leads(name: str, spp: int, kind: str, signal: str) -> list[float]:
        return [cells[name, spp, signal, c][kind] - cells["oidn", spp, signal, c][kind] for c in clips]

    def lead(name: str, spp: int, kind: str) -> str:
        return ", ".join(f"{np.mean(leads(name, spp, kind, s)):+.2f}" for s in SIGNALS)

    first = document["levels"][0]
    heads = " | ".join(f"{kind}, {spp} spp" for kind in ("single", "later") for spp in document["levels"])
    main = [f"| | {heads} |", "|---" * (2 * len(document["levels"]) + 1) + "|"]
    exposures = ["| | " + " | ".join(f"{kind}, ×{2.0**s:g}" for kind in ("single", "later") for s in STOPS) + " |",
                 "|---" * (2 * len(STOPS) + 1) + "|"]  # fmt: skip
    by_clip = [f"| | {' | '.join(clips)} |", "|---" * (len(clips) + 1) + "|"]
    for name in document["weights"]:
        label = f"`{name}`" if "/" not in name else f"`{Path(name).parent.name}`"
        values = [lead(name, spp, f"{kind} +0") for kind in ("single", "later") for spp in document["levels"]]
        main.append(f"| {label} | {' | '.join(values)} |")
        values = [lead(name, first, f"{kind} {s:+d}") for kind in ("single", "later") for s in STOPS]
        exposures.append(f"| {label} | {' | '.join(values)} |")
        for kind in ("single", "later"):
            both = zip(*(leads(name, first, f"{kind} +0", s) for s in SIGNALS), strict=True)
            by_clip.append(f"| {label}, {kind} | {' | '.join(f'{a:+.2f}, {b:+.2f}' for a, b in both)} |")
    return {"held": "\n".join(main), "held-exposures": "\n".join(exposures), "held-clips": "\n".join(by_clip)}


if __name__ == "__main__":
    harness.run(main, __doc__)
