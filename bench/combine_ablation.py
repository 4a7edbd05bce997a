"""What do the parts of the deep residual combiner gain? The paper's ablations: pyramid, frames, residuals as input.

python bench/combine_ablation.py HELD ... --data CLIPS ... [--steps 300]

Trains every variant of `combiner` with two seeds for the same number of steps on CLIPS (`combine_clips.py`, several
sample counts, `rtdenoise estimates` beside them), then measures them on HELD as `combine.py` does: the geometric mean
of a combiner's corrected MSE over that of the denoised frames. Runs are kept in --runs; finished ones are taken. Writes
bench/results/combine_ablation.json and a table of docs/results/combine.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
import tyro

from bench.combine import measure, summary
from rtdenoise.data.clips import ClipDataset
from rtdenoise.models import COMBINERS, load_combiner
from rtdenoise.models.presets import with_settings
from rtdenoise.training.config import TrainConfig
from rtdenoise.training.loop import WEIGHTS, train

RESULT, PAGES = RESULTS / "combine_ablation.json", (DOCS / "results" / "combine.md",)
LEVELS = (1, 4, 16, 64)
# Without the statistics of residuals, which the paper does not have, and which hold the residuals again.
BASE = ("statistics=false",)
FREE = "evidence=false"  # weights sum to 1, as in the paper; a single frame has no evidence
VARIANTS = {
    "whole": ("pyramid, five frames, residuals as input", ()),
    "flat": ("no pyramid: one scale", ("scales=1",)),
    "no-residual": ("y and z as input alone", ("residual_input=false",)),
    "statistics": ("with the statistics of residuals, ours", ("statistics=true",)),
    "free": ("weights that sum to 1", (FREE,)),
    "single": ("weights that sum to 1, one frame", (FREE, "frames=1")),
}


def main(
    held: tyro.conf.Positional[tuple[Path, ...]],
    data: tuple[Path, ...],
    runs: Path = ROOT / "data" / "combiner-runs",
    steps: int = 300,
    seeds: int = 2,
    levels: tuple[int, ...] = LEVELS,
) -> None:
    """Train, then measure.

    Args:
        held: Folders with a folder of clips for each sample count, of scenes that are not in --data.
        data: Folders of training clips.
        runs: Folder of the runs.
        steps: Of each training.
        seeds: Trainings of each variant.
        levels: Sample counts to measure.
    """
    names = [f"{name}.{seed}" for seed in range(seeds) for name in VARIANTS]
    networks = {}
    for name in names:
        train(config_of(name, data, runs / name, steps))
        networks[name] = load_combiner(runs / name / WEIGHTS, precision="fp32")
        print(name, flush=True)
    rows = [row for folder in held for row in measure(folder, ("oidn", "default"), networks, levels)]
    clips = ClipDataset(*data)
    document = {"steps": steps, "clips": len(clips), "scenes": len(clips.scenes())}
    harness.publish(RESULT, document | {"summary": summary(rows), "rows": rows}, digits=4, pages=PAGES, tables=tables)


def config_of(name: str, data: tuple[Path, ...], run: Path, steps: int) -> TrainConfig:
    """The training of the variant and seed NAME.SEED."""
    variant, seed = name.rsplit(".", 1)
    settings = (*BASE, *VARIANTS[variant][1])
    return TrainConfig(
        data=data, out=run, model="combiner", set=settings, signal="both",
        frames=with_settings(COMBINERS["combiner"], settings).frames, batch=4, size=96, steps=steps, lr=4e-4,
        warmup=50, optimiser="muon", seed=int(seed),
    )  # fmt: skip


def tables(document: dict) -> dict[str, str]:
    """Section `combine-ablation`: a line for each variant, seeds apart."""
    levels = sorted({row["spp"] for row in document["rows"]})
    heads = " | ".join(f"{spp} spp" for spp in levels)
    lines = [f"| | error over z's, by seed | {heads} | failures |", "|---" * (len(levels) + 3) + "|"]
    for name, (what, _) in VARIANTS.items():
        seeds = [document["summary"][key] for seed in range(9) if (key := f"{name}.{seed}") in document["summary"]]
        if seeds:
            ratios = ", ".join(f"{found['ratio']:.3f}" for found in seeds)
            by = (sum(found["by_spp"][str(spp)] for found in seeds) / len(seeds) for spp in levels)
            failures = ", ".join(f"{found['failures']} of {found['cells']}" for found in seeds)
            lines.append(f"| {what} | {ratios} | {' | '.join(f'{x:.3f}' for x in by)} | {failures} |")
    told = f"{document['steps']} steps on {document['clips']} clips of {document['scenes']} scenes."
    return {"combine-ablation": "\n".join(lines), "combine-ablation-training": told}


if __name__ == "__main__":
    harness.run(main, __doc__)
