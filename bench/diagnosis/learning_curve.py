"""What would more clips buy, and what more hours? `default` from random weights, on ever more clips and ever longer.

python bench/diagnosis/learning_curve.py SEQ [SEQ ...] --data CLIPS [CLIPS ...] --out runs/curve

One curve gives the same number of steps to ever more clips, the other ever more steps to all clips; the smaller sets
are part of the larger ones. Every run ends with its own learning rate at zero, so no run is cut short. Measured is the
lead over OIDN in corrected PSNR on sequences that no clip shows, first frames apart. A run that is there is not trained
again. Writes bench/results/learning_curve.json and the table of docs/notes/learning_curve.md.
"""

from __future__ import annotations

import json
import sys
from copy import copy
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.opening import open_sequence
from rtdenoise.metrics.image import decibels, mse_corrected
from rtdenoise.models import load
from rtdenoise.training.config import TrainConfig
from rtdenoise.training.loop import train

RESULT, PAGES = RESULTS / "learning_curve.json", (DOCS / "notes" / "learning_curve.md",)
SIGNALS = {"indirect": "indirect light", "color": "beauty"}
OPTIONS = {
    "model": "default", "signal": "both", "frames": 5, "batch": 1, "lr": 1e-3, "loss_exposure": 4.0, "huber": 0.2,
    "loss_power": 0.5,
}  # fmt: skip


def main(
    sequences: tyro.conf.Positional[tuple[Path, ...]],
    data: tuple[Path, ...],
    out: Path,
    counts: tuple[int, ...] = (25, 100),
    steps: int = 3000,
    all_steps: tuple[int, ...] = (750, 1500, 3000),
    seed: int = 0,
) -> None:
    """Train and measure every point of both curves.

    Args:
        sequences: Folders of frames with references.
        data: Folders of training clips.
        out: Folder for the runs.
        counts: Numbers of clips, trained on for `steps` steps each.
        steps: Steps of the runs on parts of the clips.
        all_steps: Steps of the runs on all clips.
        seed: Chooses the parts, and seeds the runs.
    """
    clips = ClipDataset(*data)
    clips.paths = [clips.paths[i] for i in np.random.default_rng(seed).permutation(len(clips))]
    points = [*((count, steps) for count in counts), *((len(clips), n) for n in all_steps)]
    oidn = {s: errors(Oidn().step, sequences, s) for s in SIGNALS}
    rows = []
    for count, length in points:
        weights = trained(clips, count, length, out, seed)
        row = {"clips": count, "scenes": scenes(clips, count), "steps": length, "seconds": seconds(weights.parent)}
        for signal in SIGNALS:
            found = errors(load(weights, precision="fp32").step, sequences, signal)
            leads = [[decibels(a) - decibels(b) for a, b in zip(ours, theirs, strict=True)]
                     for ours, theirs in zip(found, oidn[signal], strict=True)]  # fmt: skip
            row[signal] = dict(zip(("first", "later"), np.mean(leads, axis=0).tolist(), strict=True))
        rows.append(row)
        print(rows[-1], flush=True)
    for row in rows:  # the same network and batch: what takes longer was disturbed
        row["hours"] = row["steps"] * min(r["seconds"] for r in rows) / 3600
    document = {"sequences": [s.name for s in sequences], "data": [d.name for d in data], "options": OPTIONS,
                "seed": seed, "rows": rows}  # fmt: skip
    print(tables(document)["learning-curve"])
    harness.publish(RESULT, document, digits=4, pages=PAGES, tables=tables)


def trained(clips: ClipDataset, count: int, steps: int, out: Path, seed: int) -> Path:
    """The weights of a run on the first `count` clips."""
    part = out / f"clips-{count}"
    part.mkdir(parents=True, exist_ok=True)
    for i, path in enumerate(clips.paths[:count]):
        link = part / f"clip_{i:06d}.safetensors"
        if not link.exists():
            link.symlink_to(path.resolve())
    return train(TrainConfig(data=(part,), out=out / f"{count}-{steps}", steps=steps, seed=seed, **OPTIONS))


def scenes(clips: ClipDataset, count: int) -> int:
    part = copy(clips)
    part.paths = clips.paths[:count]
    return len(part.scenes())


def seconds(run: Path) -> float:
    """Median time of a step."""
    log = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    return float(np.median([row["seconds"] for row in log if "seconds" in row]))


@torch.inference_mode()
def errors(step, sequences: tuple[Path, ...], signal: str) -> list[tuple[float, float]]:
    """Corrected MSE of each sequence's first frame, and its mean over the later ones."""
    found = []
    for folder in sequences:
        frames = list(open_sequence(folder, signal=signal, layers=("reference", "reference_half")))
        exposure = display_exposure(torch.cat([frame.reference for frame in frames]))
        images = harness.denoise(step, frames)
        each = [float(mse_corrected(image, f.reference, exposure, reference_half=f.reference_half))
                for image, f in zip(images, frames, strict=True)]  # fmt: skip
        found.append((each[0], float(np.mean(each[1:]))))
    return found


def tables(document: dict) -> dict[str, str]:
    """Section `learning-curve`: one line a run."""
    lines = [
        "| clips | scenes | steps | core-hours | indirect light, first, later | beauty, first, later |",
        "|---|---|---|---|---|---|",
    ]
    for row in document["rows"]:
        leads = (f"{row[s]['first']:+.2f}, {row[s]['later']:+.2f}" for s in SIGNALS)
        lines.append(
            f"| {row['clips']} | {row['scenes']} | {row['steps']} | {row['hours']:.2f} | {' | '.join(leads)} |"
        )
    return {"learning-curve": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
