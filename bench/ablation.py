"""The paper's experiment: traditional motion, dual motion, and the occlusion loss, on the same clips and budget.

    python bench/ablation.py --data data/train-clean --val data/val --single 700 --steps 1200

Trains the `paper` network on single frames first, in which motion and occlusions mean nothing; goes on from there on
clips in each setting with each seed (a run that is there is resumed, a finished one kept); then measures all of them on
the validation clips: over the frame, and inside what was uncovered in it, one and two frames before (M⁰, M¹, M²).
Settings A, B and C are the paper's (§5.3); C-max has max pooling as D, as the paper prints it, in single frames too,
C-bright another domain of the loss. Writes bench/results/ablation.json and the table of docs/models/paper.md.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import harness
import numpy as np
import tyro

from rtdenoise.data.clips import ClipDataset
from rtdenoise.models import PRESETS, load
from rtdenoise.training.loop import train
from rtdenoise.training.trainer import TrainConfig

SETTINGS = {
    "A": {"motion": "traditional", "occlusion_loss": False},
    "B": {"motion": "dual", "occlusion_loss": False},
    "C": {"motion": "dual", "occlusion_loss": True},
    "C-max": {"motion": "dual", "occlusion_loss": True, "preset": "paper-max"},
    "C-bright": {"motion": "dual", "occlusion_loss": True, "loss_exposure": 4.0},
}
METRICS = ("psnr", "psnr_corrected", "ssim", "l1", "mse", "relmse")
REGIONS = ("frame", "uncovered", "uncovered-1", "uncovered-2")
RESULT = harness.ROOT / "bench" / "results" / "ablation.json"
PAGE = harness.ROOT / "docs" / "models" / "paper.md"
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
    """Steps on single frames, 16 a step, that every run starts from."""
    frames: int = 9
    """Frames a clip."""
    runs: Path = Path("runs/ablation")
    """Folder of the training runs."""
    steps: int = 1200
    """Steps of each run."""
    seeds: int = 2
    """Runs a setting."""
    settings: tuple[str, ...] = ("A", "B", "C")
    """Of A, B, C, C-max, C-bright."""


def main(options: Options) -> None:
    PRESETS["paper-max"] = replace(PRESETS["paper"], pool="max")
    rows = []
    clips = ClipDataset(options.val)
    single = {preset: single_frames(options, preset) for preset in {preset_of(setting) for setting in options.settings}}
    for seed in range(options.seeds):  # seed by seed: an interrupted bench has compared all settings once
        for setting in options.settings:
            config = TrainConfig(
                data=options.data, out=options.runs / f"{setting}-{seed}", init=single[preset_of(setting)],
                steps=options.steps, frames=options.frames, seed=seed, **SETTINGS[setting],
            )  # fmt: skip
            row = {"setting": setting, "seed": seed, "errors": errors(train(config), clips)}
            rows.append(row)
            print(f"{setting} seed {seed}: " + ", ".join(f"{k} {v['psnr']:.2f} dB" for k, v in row["errors"].items()))
            harness.write(
                RESULT,
                **harness.origin({"torch": harness.cpu()}),
                steps=options.steps,
                single=options.single,
                frames=options.frames,
                clips=len(clips),
                rows=rows,
            )
    harness.insert_all(tables(json.loads(RESULT.read_text())), PAGE)


def preset_of(setting: str) -> str:
    return SETTINGS[setting].get("preset", "paper")


def single_frames(options: Options, preset: str) -> Path:
    """Weights that have seen single frames only."""
    out = options.runs / f"single-{preset}"
    steps = {"steps": options.single, "frames": 1, "batch": 16}
    return train(TrainConfig(options.data, out, preset=preset, occlusion_loss=False, **steps))


def errors(weights: Path, clips: ClipDataset) -> dict[str, dict[str, float]]:
    """Mean errors over the clips, by region and metric."""
    sequences = (clips.load(i, signal="indirect") for i in range(len(clips)))
    return harness.mean_errors(load(weights, precision="fp32").step, sequences, METRICS, REGIONS)


def tables(document: dict) -> dict[str, str]:
    """The section of docs/models/paper.md: mean over the seeds, and half their spread."""
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
    main(tyro.cli(Options))
