"""The paper's experiment: traditional motion, dual motion, and the occlusion loss, on the same clips and budget.

python bench/ablation.py --data data/train-clean --val data/val --single 700 --steps 1200

Trains the `paper` network on single frames first, where motion and occlusions do not matter; then continues on clips in
each setting with each seed (unfinished runs resume, finished ones are kept). Measures all on the validation clips: over
the frame, and in regions uncovered in it, one and two frames before (M⁰, M¹, M²). A, B and C are the paper's settings
(§5.3). C-max uses max pooling for D, as the paper prints it, from the single frames on; C-bright takes the loss on
log(1 + 4·s·x). Writes bench/results/ablation.json and the table of docs/reference/models/paper.md.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np

from rtdenoise.data.clips import ClipDataset
from rtdenoise.models import load
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig

SETTINGS = {
    "A": {"motion": "traditional", "occlusion_loss": False},
    "B": {"motion": "dual", "occlusion_loss": False},
    "C": {"motion": "dual", "occlusion_loss": True},
    "C-max": {"motion": "dual", "occlusion_loss": True, "set": ("pool=max",)},
    "C-bright": {"motion": "dual", "occlusion_loss": True, "loss_exposure": 4.0},
}
METRICS = ("psnr", "psnr_corrected", "ssim", "l1", "mse", "relmse")
REGIONS = ("frame", "uncovered", "uncovered-1", "uncovered-2")
RESULT, PAGES = RESULTS / "ablation.json", (DOCS / "reference" / "models" / "paper.md",)
COLUMNS = [  # label, metric, region, digits
    *(("corrected PSNR", "psnr_corrected", region, 2) for region in REGIONS),
    *(("SSIM", "ssim", region, 3) for region in REGIONS[:2]),
    *(("L1", "l1", region, 4) for region in REGIONS[:2]),
    *(("MSE", "mse", region, 4) for region in REGIONS[:2]),
    ("relMSE", "relmse", "uncovered", 3),
]


@dataclass(frozen=True)
class Options:
    data: tuple[Path, ...]
    """Folders of training clips."""
    val: Path
    """Validation clips, of other scenes."""
    single: int = 700
    """Steps on single frames, 16 per step, before every run."""
    frames: int = 9
    """Frames per clip."""
    runs: Path = Path("runs/ablation")
    """Folder of the training runs."""
    steps: int = 1200
    """Steps of each run."""
    seeds: int = 2
    """Runs per setting."""
    settings: tuple[str, ...] = ("A", "B", "C")
    """Some of A, B, C, C-max, C-bright."""


def main(options: Options) -> None:
    rows: list[dict] = []
    clips = ClipDataset(options.val)
    facts = {"steps": options.steps, "single": options.single, "frames": options.frames, "clips": len(clips)}
    for seed in range(options.seeds):  # seed by seed: an interrupted bench has compared all settings once
        for setting in options.settings:
            config = TrainConfig(
                data=options.data, out=options.runs / f"{setting}-{seed}", model="paper",
                init=single_frames(options, setting),
                steps=options.steps, frames=options.frames, seed=seed, **SETTINGS[setting],
            )  # fmt: skip
            row = {"setting": setting, "seed": seed, "errors": errors(train(config), clips)}
            rows.append(row)
            print(f"{setting} seed {seed}: " + ", ".join(f"{k} {v['psnr']:.2f} dB" for k, v in row["errors"].items()))
            harness.publish(RESULT, facts | {"rows": rows}, pages=PAGES, tables=tables)


def single_frames(options: Options, setting: str) -> Path:
    """Weights trained on single frames alone, from which a setting starts; all settings of one network share them."""
    network = {key: value for key, value in SETTINGS[setting].items() if key == "set"}
    out = options.runs / ("single-paper-max" if network else "single-paper")
    steps = {"steps": options.single, "frames": 1, "batch": 16}
    return train(TrainConfig(options.data, out, model="paper", occlusion_loss=False, **steps, **network))


def errors(weights: Path, clips: ClipDataset) -> dict[str, dict[str, float]]:
    """Mean errors over the clips, by region and metric."""
    sequences = (clips.load(i, signal="indirect") for i in range(len(clips)))
    return harness.mean_errors(load(weights, precision="fp32").step, sequences, METRICS, REGIONS)


def tables(document: dict) -> dict[str, str]:
    """Section `ablation`: mean over the seeds ± half their range."""
    rows = document["rows"]
    lines = ["| setting | " + " | ".join(f"{label}, {region}" for label, _, region, _ in COLUMNS) + " |"]
    lines.append("|---" * (len(COLUMNS) + 1) + "|")
    for setting in dict.fromkeys(row["setting"] for row in rows):
        runs = [row["errors"] for row in rows if row["setting"] == setting]
        cells = [spread([run[region][metric] for run in runs], digits) for _, metric, region, digits in COLUMNS]
        lines.append(f"| {setting} | " + " | ".join(cells) + " |")
    return {"ablation": "\n".join(lines)}


def spread(values: list[float], digits: int) -> str:
    return f"{np.mean(values):.{digits}f} ± {(max(values) - min(values)) / 2:.{digits}f}"


if __name__ == "__main__":
    harness.run(main, __doc__)
