"""Which channels of a network ever do something: those that its ReLUs let through anywhere in the bundled sequence.

    python bench/activity.py

A channel that is zero everywhere is arithmetic for nothing, and gets no gradient either. Writes
bench/results/activity.json and the table of docs/training.md.
"""

from __future__ import annotations

import json
from functools import partial

import harness
import torch
from torch import Tensor, nn

from rtdenoise import open_sequence
from rtdenoise.models import available, read

RESULT, PAGE = harness.ROOT / "bench" / "results" / "activity.json", harness.ROOT / "docs" / "training.md"
SIGNALS = ("indirect", "color")


def main() -> None:
    rows = [{"model": name, "layers": active(name)} for name in available()]
    harness.write(RESULT, digits=3, **harness.origin({"torch": harness.cpu()}), rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


@torch.inference_mode()
def active(name: str) -> dict[str, float]:
    """Layer of the U-Net -> share of its channels that are above zero in some pixel of some frame, of either signal."""
    model, found = read(name).eval(), {}

    def look(layer: str, module: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        found[layer] = found.get(layer, False) | (output > 0).flatten(2).any(2).any(0)

    for layer, module in model.unet.named_modules():
        if isinstance(module, nn.ReLU):
            module.register_forward_hook(partial(look, layer))
    for signal in SIGNALS:
        history = None
        for frame in open_sequence(harness.ROOT / "samples" / "mural", signal=signal):
            _, history = model.step(frame, history)
    return {layer: seen.float().mean().item() for layer, seen in found.items()}


def tables(document: dict) -> dict[str, str]:
    """Share of active channels by level of the U-Net, finest first, over the four (coarsest: two) layers of each."""
    levels = max(level(layer) for row in document["rows"] for layer in row["layers"]) + 1
    lines = ["| | " + " | ".join(f"level {k + 1}" for k in range(levels)) + " |", "|---" * (levels + 1) + "|"]
    for row in document["rows"]:
        shares = [[v for layer, v in row["layers"].items() if level(layer) == k] for k in range(levels)]
        cells = [f"{sum(s) / len(s):.0%}" if s else "–" for s in shares]
        lines.append(f"| `{row['model']}` | " + " | ".join(cells) + " |")
    return {"activity": "\n".join(lines)}


def level(layer: str) -> int:
    """Of 'encoder.2.1' or 'decoder.2.3': 2."""
    return int(layer.split(".")[1])


if __name__ == "__main__":
    main()
