"""What pick kernels gain: networks trained on with and without them, from the weights that ship, on the same clips.

    python bench/pick_kernel.py --data data/scenes-clean data/sun3-clean --val data/val

Every network is measured on the validation clips, both signals. A run that is there is resumed, a finished one kept;
`--only fast-3` trains one alone and measures nothing, so that processes may share the work. Writes
bench/results/pick_kernel.json and the table of docs/training.md.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import harness
import tyro

from rtdenoise.data.clips import ClipDataset
from rtdenoise.models import PRESETS, load
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig

RESULT = harness.ROOT / "bench" / "results" / "pick_kernel.json"
WEIGHTS = harness.ROOT / "rtdenoise" / "weights"
PAGE = harness.ROOT / "docs" / "training.md"
RUNS = {"fast": (700, 6e-4), "default": (500, 5e-4)}  # preset -> steps, peak learning rate
SIDES = {1: "without", 3: "3×3"}  # of the pick kernels
SIGNALS, REGIONS = ("indirect", "color"), ("frame", "uncovered")


@dataclass(frozen=True)
class Options:
    data: tuple[Path, ...]
    """Folders of training clips."""
    val: Path
    """Validation clips, of other scenes."""
    only: str = ""
    """Train this network alone, such as 'fast-3', and measure nothing."""
    runs: Path = Path("runs/pick-kernel")
    """Folder of the training runs."""


def main(options: Options) -> None:
    clips, training = ClipDataset(options.val), ClipDataset(*options.data)
    if shared := clips.scenes() & training.scenes():
        sys.exit(f"{options.val}: shows scenes that are in the training clips too: {', '.join(sorted(shared))}")
    if options.only:
        preset, _, side = options.only.partition("-")
        train_on(options, preset, int(side))
        return
    rows = []
    for preset in RUNS:
        networks = {"as it ships": WEIGHTS / f"{preset}.safetensors"}
        networks |= {name: train_on(options, preset, side) for side, name in SIDES.items()}
        rows += [{"preset": preset, "network": n, "errors": errors(w, clips)} for n, w in networks.items()]
    origin = harness.origin({"torch": harness.cpu()})
    harness.write(RESULT, **origin, steps_and_rates=RUNS, clips=len(training), validation_clips=len(clips), rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


def train_on(options: Options, preset: str, side: int) -> Path:
    """The weights of a run whose network has pick kernels of this side."""
    PRESETS[preset] = replace(PRESETS[preset], pick_kernel=side)
    steps, rate = RUNS[preset]
    config = TrainConfig(
        options.data, options.runs / f"{preset}-{side}", init=WEIGHTS / f"{preset}.safetensors", preset=preset,
        signal="both", optimiser="muon", lr=rate, steps=steps, loss_exposure=4.0, huber=0.2, cuts=0.5, relight=0.05,
    )  # fmt: skip
    return train(config)


def errors(weights: Path, clips: ClipDataset) -> dict[str, dict[str, float]]:
    """Corrected PSNR by signal and region, mean over the clips."""
    step, found = load(weights, precision="fp32").step, {}
    for signal in SIGNALS:
        sequences = (clips.load(i, signal=signal) for i in range(len(clips)))
        means = harness.mean_errors(step, sequences, ("psnr_corrected",), REGIONS)
        found[signal] = {region: round(means[region]["psnr_corrected"], 3) for region in REGIONS}
    return found


def tables(document: dict) -> dict[str, str]:
    """The section of docs/training.md."""
    names = {"indirect": "indirect", "color": "beauty"}
    heads = [f"{names[signal]}, {region}" for signal in SIGNALS for region in REGIONS]
    lines = [f"| | pick kernels | {' | '.join(heads)} |", "|---" * (len(heads) + 2) + "|"]
    for row in document["rows"]:
        cells = [f"{row['errors'][signal][region]:.2f} dB" for signal in SIGNALS for region in REGIONS]
        lines.append(f"| `{row['preset']}` | {row['network']} | {' | '.join(cells)} |")
    return {"pick": "\n".join(lines)}


if __name__ == "__main__":
    main(tyro.cli(Options))
