"""By what should light be divided, so that a filter keeps textures? Blurred references, by divisor.

python bench/diagnosis/divisor.py CLIPS...

References are divided by a function of the albedo, blurred, multiplied again: a divisor is good where little is lost.
One half of a reference is blurred and compared with the other half, whose noise is taken off. Pixels at edges of normal
or depth are left out: no divisor helps there. Writes bench/results/divisor.json and the table of docs/notes/divisor.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor
from torch.nn import functional as F

from rtdenoise.color import display, display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.frame import Frame

RESULT, PAGES = RESULTS / "divisor.json", (DOCS / "notes" / "divisor.md",)
SIGNALS = ("indirect", "color")
SIGMA = 2.0  # pixels, of the blur
MAX_TURN, MAX_STEP = 0.1, 0.02  # of blurred normals and relative depths against sharp ones, away from edges
LEAST_SHARE = 0.02  # of the pixels of a frame that must lie away from edges
LEAST = 1e-7  # squared error that a logarithm is taken of
FORMER = "max(albedo, 0.1, brightest / 4)"
ADDED = (0.04, 0.08, 0.13, 0.2, 0.3)


@torch.inference_mode()
def main(clips: tyro.conf.Positional[tuple[Path, ...]], count: int = 40) -> None:
    """Measure the first frames of so many clips of each folder."""
    rows = [row for folder in clips for row in measured(folder, count)]
    harness.publish(RESULT, {"sigma": SIGMA, "rows": rows}, digits=4, pages=PAGES, tables=tables)


def measured(folder: Path, count: int) -> Iterator[dict]:
    """A row for every clip and signal: dB over the former divisor."""
    data = ClipDataset(folder)
    for index, signal in ((i, s) for i in range(min(count, len(data))) for s in SIGNALS):
        frame = data.load(index, signal=signal)[0]
        inner = away_from_edges(frame)
        if inner.float().mean() < LEAST_SHARE:
            continue
        errors = {name: lost(frame, divisor, inner) for name, divisor in divisors(frame.albedo).items()}
        gains = {name: 10 * np.log10(errors[FORMER] / error) for name, error in errors.items() if name != FORMER}
        yield {"set": "/".join(folder.parts[-2:]), "signal": signal, "gains": gains}


def divisors(albedo: Tensor) -> dict[str, Tensor]:
    """Name -> divisor of every pixel."""
    floor = (albedo.amax(dim=1, keepdim=True) / 4).clamp(min=0.1)
    return {
        "1": torch.ones_like(albedo),
        FORMER: albedo.maximum(floor),
        **{f"albedo + {gloss:g}": albedo + gloss for gloss in ADDED},
    }


def lost(frame: Frame, divisor: Tensor, inner: Tensor) -> float:
    """Squared error of the blurred half of the reference on a screen, without the noise of the half it is compared
    with."""
    scale, first = display_exposure(frame.reference), frame.reference_half
    second = 2 * frame.reference - first
    divisor = divisor.where(frame.depth > 0, 1.0)
    image = blurred(first / divisor) * divisor
    apart = (display(image, scale) - display(second, scale)) ** 2
    noise = (display(first, scale) - display(second, scale)) ** 2 / 2
    return max(LEAST, float((apart - noise).mean(1, keepdim=True)[inner].mean()))


def away_from_edges(frame: Frame) -> Tensor:
    """`[1, 1, H, W]` bool."""
    turn = (blurred(frame.normal) - frame.normal).abs().sum(1, keepdim=True)
    step = (blurred(frame.depth) - frame.depth).abs() / frame.depth.clamp(min=1e-6)
    return (turn < MAX_TURN) & (step < MAX_STEP)


def blurred(image: Tensor) -> Tensor:
    radius, channels = int(3 * SIGMA), image.shape[1]
    weights = torch.exp(-(torch.arange(-radius, radius + 1.0) ** 2) / (2 * SIGMA**2))
    row = (weights / weights.sum()).expand(channels, 1, 1, -1)
    image = F.pad(image, (radius,) * 4, mode="reflect")
    return F.conv2d(F.conv2d(image, row, groups=channels), row.transpose(2, 3), groups=channels)


def tables(document: dict) -> dict[str, str]:
    """Section `divisor`: mean, and the tenth of the frames that gains least."""
    rows = document["rows"]
    cells = list(dict.fromkeys((row["set"], row["signal"]) for row in rows))
    lines = ["| | " + " | ".join(f"`{name}`, {signal}" for name, signal in cells) + " |",
             "|---" * (len(cells) + 1) + "|"]  # fmt: skip
    for name in rows[0]["gains"]:
        found = [[row["gains"][name] for row in rows if (row["set"], row["signal"]) == cell] for cell in cells]
        texts = (f"{np.mean(gains):+.2f} ({np.percentile(gains, 10):+.2f})" for gains in found)
        lines.append(f"| {name} | {' | '.join(texts)} |")
    return {"divisor": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
