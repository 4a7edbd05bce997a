"""Which channels of a network ever do something: those that its ReLUs let through anywhere.

    python bench/activity.py CLIPS [CLIPS ...]

A channel that is zero everywhere is arithmetic for nothing, and gets no gradient either. But one may wait for what a
sequence does not show: so the bundled sequence stands beside `COUNT` clips of each folder, evenly taken. Writes
bench/results/activity.json and the table of docs/training.md.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import harness
import torch
from torch import Tensor, nn

from rtdenoise import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.models import available, read

RESULT, PAGE = harness.ROOT / "bench" / "results" / "activity.json", harness.ROOT / "docs" / "training.md"
SIGNALS = ("indirect", "color")
COUNT = 6


def main(folders: list[Path]) -> None:
    shown = {
        "the bundled sequence": sample,
        "clips": lambda signal: (frames for folder in folders for frames in harness.clips(folder, COUNT, signal)),
    }
    rows = [
        {"model": name, "shown": what, "layers": active(name, sequences)}
        for name in available()
        for what, sequences in shown.items()
    ]
    harness.write(RESULT, digits=3, **harness.origin({"torch": harness.cpu()}), clips_a_folder=COUNT, rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


def sample(signal: str) -> Iterable[list[Frame]]:
    return [list(open_sequence(harness.ROOT / "samples" / "mural", signal=signal))]


@torch.inference_mode()
def active(name: str, sequences: Callable[[str], Iterable[list[Frame]]]) -> dict[str, float]:
    """Layer of the U-Net -> share of its channels that are above zero in some pixel of some frame, of either signal."""
    model, found = read(name).eval(), {}

    def look(layer: str, module: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        found[layer] = found.get(layer, False) | (output > 0).flatten(2).any(2).any(0)

    for layer, module in model.unet.named_modules():
        if isinstance(module, nn.ReLU):
            module.register_forward_hook(partial(look, layer))
    for signal in SIGNALS:
        for frames in sequences(signal):
            history = None
            for frame in frames:
                _, history = model.step(frame, history)
    return {layer: seen.float().mean().item() for layer, seen in found.items()}


def tables(document: dict) -> dict[str, str]:
    """Share of active channels by level of the U-Net, finest first, over the four (coarsest: two) layers of each."""
    levels = max(level(layer) for row in document["rows"] for layer in row["layers"]) + 1
    lines = ["| | in | " + " | ".join(f"level {k + 1}" for k in range(levels)) + " |", "|---" * (levels + 2) + "|"]
    for row in document["rows"]:
        shares = [[v for layer, v in row["layers"].items() if level(layer) == k] for k in range(levels)]
        cells = [f"{sum(s) / len(s):.0%}" if s else "–" for s in shares]
        lines.append(f"| `{row['model']}` | {row['shown']} | " + " | ".join(cells) + " |")
    return {"activity": "\n".join(lines)}


def level(layer: str) -> int:
    """Of 'encoder.2.1' or 'decoder.2.3': 2."""
    return int(layer.split(".")[1])


if __name__ == "__main__":
    main([Path(a) for a in sys.argv[1:]])
