"""Training clips: the cost of rendering them, their content, and the speed of the loader.

python bench/data.py CLIPS NAME    # writes bench/results/data_NAME.json

Cost: clips per core-hour, from the CPU time in every clip's header. `scene` is the part paid once for several clips:
loading, surveying and exposing. Loading: clips per second as batches that `rtdenoise train` draws, from warm files, in
rotation with a training step on the same batch; the loader must be far faster. Error of the references: relative
squared error of the mean of two independent halves a and b, estimated as (a - b)² / 4 over the squared mean.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.color import luminance
from rtdenoise.data.clips import ClipDataset
from rtdenoise.frame import stack
from rtdenoise.motion import dual_motion, occlusion_mask
from rtdenoise.training.trainer import TrainConfig, Trainer

BATCH, FRAMES, SIZE = 2, 9, 96  # windows, frames, pixels per side


def content(clips: ClipDataset) -> dict:
    """Shares of uncovered pixels and errors of the references, over all clips."""
    shares, errors = [], []
    for index in range(len(clips)):
        frames = clips.load(index)
        masks = [
            occlusion_mask(dual_motion(now.motion, before.motion_next), now.motion)
            for before, now in itertools.pairwise(frames)
        ]
        shares.append(torch.cat(masks).float().mean().item())
        for frame in frames:
            mean = luminance(frame.reference)
            squared = (luminance(frame.reference_half) - mean).square()  # (a - b)² / 4, since mean = (a + b) / 2
            errors.append((squared / (mean.square() + (0.1 * mean.mean()).square() + 1e-12)).clamp(max=1).mean().item())
    return {
        "uncovered_share": {
            "mean": round(float(np.mean(shares)), 4),
            "clips_above_1.5%": round(float(np.mean(np.array(shares) > 0.015)), 3),
        },
        "reference_error": {
            k: round(float(v), 5) for k, v in zip(("median", "mean"), (np.median(errors), np.mean(errors)), strict=True)
        },
    }


def cost(clips: ClipDataset) -> dict:
    """Cost of rendering, from the facts in the clips' headers."""
    facts = [clips.facts(i) for i in range(len(clips))]
    seconds = sum(f["seconds"] for f in facts)
    opening = sum(f.get("scene_seconds", 0.0) for f in facts)
    return {
        "core_seconds_a_clip": round(seconds / len(facts), 1),
        "of_which_scene": round(opening / len(facts), 1),
        "clips_a_core_hour": round(3600 * len(facts) / seconds),
        "reference_spp_mean": round(float(np.mean([f["reference_spp"] for f in facts]))),
        "bytes_a_clip": int(np.mean([path.stat().st_size for path in clips.paths])),
    }


def main(folder: tyro.conf.Positional[Path], name: tyro.conf.Positional[str]) -> None:
    torch.set_num_threads(1)
    clips, rng = ClipDataset(folder), np.random.default_rng(0)
    trainer = Trainer(TrainConfig((folder,), folder, model="paper", batch=BATCH, frames=FRAMES, size=SIZE))

    def load() -> list:
        windows = [
            clips.load(int(rng.integers(len(clips))), signal="indirect", size=SIZE, frames=FRAMES, rng=rng)
            for _ in range(BATCH)
        ]
        return [stack(list(frames)) for frames in zip(*windows, strict=True)]

    batch = load()
    timings = harness.measure({"load": load, "train_step": lambda: trainer.train_step(batch)}, calls=7, warmup=1)
    loaded, step = timings["load"].median_ms, timings["train_step"].median_ms
    result = {
        "clips": len(clips),
        "rendered": cost(clips),
        **content(clips),
        "loaded": {
            "batch": f"{BATCH} windows of {FRAMES} frames, {SIZE}×{SIZE}",
            "clips_a_second": round(1000 * BATCH / loaded, 1),
            "training_step_over_load": round(step / loaded, 1),
        },
        "timings": timings,
    }
    print(result)
    harness.publish(RESULTS / f"data_{name}.json", result)


if __name__ == "__main__":
    harness.run(main, __doc__)
