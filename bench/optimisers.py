"""What an optimiser reaches in a given number of steps: the same network, first weights and batches.

    python bench/optimisers.py --data data/train-clean ... --val data/val

Trains `default` on single frames with each optimiser at each peak rate, and measures the loss of the last steps and the
error on first frames of validation clips. Runs are kept in --runs; a finished one is not run again.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import harness
import numpy as np
import torch
import tyro

from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.metrics import psnr_corrected
from rtdenoise.models import load
from rtdenoise.training.config import TrainConfig
from rtdenoise.training.loop import train

RESULT = harness.ROOT / "bench" / "results" / "optimisers.json"
RATES = {"adam": (1e-3, 3e-3), "muon": (1e-3, 3e-3)}
LAST = 5  # lines of the log, of 20 steps each, that the final loss is the mean of


@dataclass(frozen=True)
class Options:
    data: tuple[Path, ...]
    """Folders of training clips."""
    val: Path
    """Validation clips, of other scenes."""
    runs: Path = Path("runs/optimisers")
    """Folder of the training runs."""
    steps: int = 300
    """Steps of each."""


def main(options: Options) -> None:
    clips, rows = ClipDataset(options.val), []
    for optimiser, rates in RATES.items():
        for rate in rates:
            config = TrainConfig(
                data=options.data, out=options.runs / f"{optimiser}-{rate:g}", preset="default", optimiser=optimiser,
                lr=rate, steps=options.steps, frames=1, batch=16, occlusion_loss=False, signal="both",
                loss_exposure=4.0, huber=0.2,
            )  # fmt: skip
            started = time.process_time()
            weights = train(config)
            log = [json.loads(line) for line in (config.out / "log.jsonl").read_text().splitlines()]
            rows.append({
                "optimiser": optimiser, "peak_rate": rate, "cpu_minutes": (time.process_time() - started) / 60,
                "final_loss": float(np.mean([row["loss"] for row in log[-LAST:]])),
                "first_frames_psnr_corrected": first_frames(weights, clips),
            })  # fmt: skip
            print(rows[-1])
    harness.write(RESULT, **harness.origin({"torch": harness.cpu()}), steps=options.steps, clips=len(clips), rows=rows)
    harness.insert_all(tables(json.loads(RESULT.read_text())), harness.ROOT / "docs" / "training.md")


def tables(document: dict) -> dict[str, str]:
    """The section of docs/training.md."""
    lines = ["| optimiser | peak rate | loss of the last steps | corrected PSNR, first frames |", "|---|---|---|---|"]
    for row in document["rows"]:
        psnr = row["first_frames_psnr_corrected"]
        lines.append(f"| {row['optimiser']} | {row['peak_rate']:g} | {row['final_loss']:.4f} | {psnr:.2f} dB |")
    return {"optimisers": "\n".join(lines)}


@torch.inference_mode()
def first_frames(weights: Path, clips: ClipDataset) -> float:
    """Mean PSNR in dB, without the noise of the references, of frames that are denoised without history."""
    step, found = load(weights, precision="fp32").step, []
    for index in range(len(clips)):
        frames = clips.load(index, signal="indirect")
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for frame in frames[::5]:
            image, _ = step(frame)
            found.append(psnr_corrected(image, frame.reference, scale, reference_half=frame.reference_half))
    return float(np.nanmean(found))


if __name__ == "__main__":
    main(tyro.cli(Options))
