"""Which channels of a network are ever active: above zero after their ReLU in some pixel?

python bench/diagnosis/activity.py CLIPS [CLIPS ...]

A channel that is zero everywhere costs arithmetic and gets no gradient. It may be waiting for content that a sequence
lacks, so the bundled sequence stands beside `COUNT` evenly spaced clips of each folder. Writes
bench/results/activity.json and the table of docs/results/training.md.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro
from torch import Tensor, nn

from rtdenoise.frame import Frame
from rtdenoise.models import available, read

RESULT, PAGES = RESULTS / "activity.json", (DOCS / "results" / "training.md",)
SIGNALS = ("indirect", "color")
COUNT = 6  # clips of each folder


def main(folder: tyro.conf.Positional[Path], more: tyro.conf.Positional[tuple[Path, ...]] = ()) -> None:
    folders = [folder, *more]
    shown = {
        "the bundled sequence": lambda signal: [harness.mural(signal)],
        "clips": lambda signal: (frames for folder in folders for frames in harness.clips(folder, COUNT, signal)),
    }
    rows = [
        {"model": name, "shown": label, "layers": active(name, sequences)}
        for name in available()
        for label, sequences in shown.items()
    ]
    harness.publish(RESULT, {"clips_a_folder": COUNT, "rows": rows}, digits=3, pages=PAGES, tables=tables)


def active(name: str, sequences: Callable[[str], Iterable[list[Frame]]]) -> dict[str, float]:
    """Layer of the U-Net -> share of its channels that are active in some pixel of some frame, of either signal."""
    model, found = read(name).eval(), {}

    def look(layer: str, module: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        found[layer] = found.get(layer, False) | (output > 0).flatten(2).any(2).any(0)

    for layer, module in model.unet.named_modules():
        if isinstance(module, nn.ReLU):
            module.register_forward_hook(partial(look, layer))
    for signal in SIGNALS:
        for frames in sequences(signal):
            harness.denoise(model.step, frames)
    return {layer: seen.float().mean().item() for layer, seen in found.items()}


def tables(document: dict) -> dict[str, str]:
    """Section `activity`: share of active channels by level of the U-Net, finest first, averaged over its layers."""
    levels = max(level(layer) for row in document["rows"] for layer in row["layers"]) + 1
    lines = ["| | in | " + " | ".join(f"level {k + 1}" for k in range(levels)) + " |", "|---" * (levels + 2) + "|"]
    for row in (row for row in document["rows"] if row["model"] in available()):
        shares = [[v for layer, v in row["layers"].items() if level(layer) == k] for k in range(levels)]
        cells = [f"{sum(s) / len(s):.0%}" if s else "–" for s in shares]
        lines.append(f"| `{row['model']}` | {row['shown']} | " + " | ".join(cells) + " |")
    return {"activity": "\n".join(lines)}


def level(layer: str) -> int:
    """The level in a layer's name: 2 in 'encoder.2.1' or 'decoder.2.3'."""
    return int(layer.split(".")[1])


if __name__ == "__main__":
    harness.run(main, __doc__)
