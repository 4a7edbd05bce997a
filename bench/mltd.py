"""Is a network for Metropolis renders better on them than networks for path tracing?

python bench/mltd.py SEQ ... [--clips CLIPS ... --minutes 2]

SEQ holds frames of `rtdenoise render --integrator pssmlt` with references, SEQ/spp16, SEQ/spp32 ... the same frames at
more mutations a pixel. With --clips the networks of `NETWORKS` are first trained on these clips, each for the same CPU
time: the number of steps follows from the time of a few; variants of one network take as many steps as it. `default`
trained on the same clips for the same time is the fair control. Runs are kept in --runs and resumed. Writes
bench/results/mltd.json and the tables of docs/results/mltd.md.
"""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise.baselines import Oidn
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.opening import open_sequence
from rtdenoise.evaluate import Step, evaluate
from rtdenoise.evaluate.inputs import Source
from rtdenoise.files import write_atomically
from rtdenoise.frame import Frame
from rtdenoise.models import find, load
from rtdenoise.models.shrinkage import correct
from rtdenoise.sanitise import sanitise
from rtdenoise.training.config import TrainConfig
from rtdenoise.training.loop import CHECKPOINT, WEIGHTS, train
from rtdenoise.training.trainer import Trainer

RESULT, PAGES = RESULTS / "mltd.json", (DOCS / "results" / "mltd.md",)
PROPOSALS = ROOT / "examples" / "metropolis" / "proposals.toml"
METRICS = ("psnr", "psnr_corrected", "relmse", "tpsnr") + (("fovvideovdp",) if find_spec("pyfvvdp") else ())
MAIN = "mltd-small"


@dataclass(frozen=True)
class Network:
    """A network to train."""

    what: str
    model: str = MAIN
    set: tuple[str, ...] = ()
    tuned: bool = False  # from the weights that ship
    seeds: int = 2

    @property
    def loss(self) -> dict[str, float]:
        """Options of the loss: for `default` those that its weights were trained with."""
        return {"huber": 0.2, "loss_exposure": 4.0} if self.model == "default" else {}


NETWORKS = {
    MAIN: Network("large and small steps, cross-attention"),
    "default-retrained": Network("`default`, from random weights", "default", seeds=1),
    "default-tuned": Network("`default`, from the weights that ship", "default", tuned=True, seeds=1),
    "summed": Network("the beauty alone", set=("components=1",)),
    "concat": Network("hidden features joined, no cross-attention", set=("recurrence=concat",)),
    "alone": Network("no hidden features", set=("recurrence=none",)),
}


def main(
    sequences: tyro.conf.Positional[tuple[Path, ...]],
    clips: tuple[Path, ...] = (),
    runs: Path = ROOT / "data" / "mltd-runs",
    minutes: float = 2.0,
    only: tuple[str, ...] = (),
    levels: tuple[int, ...] = (8, 16, 32, 64),
) -> None:
    """Train, then measure.

    Args:
        sequences: Folders of frames that no network was trained on.
        clips: Folders of training clips; none: measure the runs that are there.
        runs: Folder of the runs.
        minutes: CPU time of each training.
        only: Networks to train, as NAME or NAME.SEED, without measuring; none: all, and measure.
        levels: Mutations a pixel; those that a sequence lacks are left out.
    """
    names = {f"{name}.{seed}": (network, seed) for name, network in NETWORKS.items() for seed in range(network.seeds)}
    for name, (network, seed) in names.items() if clips else ():
        if not only or name in only or name.partition(".")[0] in only:
            train_for(60 * minutes, runs / name, clips, network, seed)
    if only:
        return
    trained = {name: runs / name for name in names if (runs / name / "cost.json").is_file()}
    steps: dict[str, Step] = {"noisy": lambda frame, history: (frame.radiance, None), "oidn": Oidn().step}
    steps["default"] = load("default", precision="fp32").step
    steps |= {name: load(run / WEIGHTS, precision="fp32").step for name, run in trained.items()}
    rows = []
    for folder in sequences:
        source = Source.open(folder, "color", "auto", None)
        for spp in (n for n in levels if n == source.spp or (folder / f"spp{n}").is_dir()):
            place = folder if spp == source.spp else folder / f"spp{spp}"
            rows += measure(source.name, spp, source.frames(spp), proposals(place), steps)
            print(
                json.dumps([{k: v for k, v in row.items() if k != "frames"} for row in rows[-len(steps) :]]), flush=True
            )
    costs = {name: json.loads((run / "cost.json").read_text()) for name, run in trained.items()}
    document = {"training": costs, "metrics": METRICS, "rows": rows}
    harness.publish(RESULT, document, digits=5, pages=PAGES, tables=tables)


def train_for(seconds: float, run: Path, clips: tuple[Path, ...], network: Network, seed: int) -> None:
    """Train for so many CPU seconds, learning rate and all: the steps are counted ahead. What it cost is in
    cost.json."""
    if (run / "cost.json").is_file():
        return
    config = TrainConfig(
        data=clips, out=run, init=find("default") if network.tuned else None, model=network.model, set=network.set,
        signal="color", batch=1, frames=7, size=64, lr=1e-3, warmup=10, seed=seed, amp=False,
        **network.loss,
    )  # fmt: skip
    planned = run.parent / (f"{MAIN}.0" if network.model == MAIN else run.name) / "steps.json"  # variants take as many
    if not planned.is_file():
        steps = max(2, int(seconds / seconds_a_step(replace(config, out=planned.parent))))
        write_atomically(planned, json.dumps(steps).encode())
    config = replace(config, steps=json.loads(planned.read_text()))
    started, whole = time.process_time(), not (run / CHECKPOINT).is_file()
    train(config)
    spent = round(time.process_time() - started, 1) if whole else None  # an interrupted run was not timed as a whole
    count = len(ClipDataset(*clips))
    cost = {"steps": config.steps, "cpu_seconds": spent, "clips": count, "what": network.what}
    write_atomically(run / "cost.json", json.dumps(cost).encode())
    print(run.name, cost, flush=True)


def seconds_a_step(config: TrainConfig) -> float:
    """Median CPU time of a step, after one that warms up."""
    config.out.mkdir(parents=True, exist_ok=True)
    data, trainer, times = ClipDataset(*config.data), Trainer(config), []
    for step in range(4):
        started = time.process_time()
        trainer.train_step(trainer.task.batch(data, config, step, (0, 1)))
        times.append(time.process_time() - started)
    return float(np.median(times[1:]))


def measure(
    sequence: str, spp: int, frames: list[Frame], path_traced: dict[int, torch.Tensor], steps: dict[str, Step]
) -> list[dict]:
    """A row for each method on one input. Networks for Metropolis renders appear with their frames corrected by
    shrunk residuals of the large proposals too."""
    chains = {f"{name}+shrinkage": corrected(step, path_traced) for name, step in steps.items()
              if name == f"{MAIN}.0" and path_traced}  # fmt: skip
    results = evaluate(frames, steps | chains, metrics=METRICS, regions=("frame",))
    return [
        {"sequence": sequence, "spp": spp, "method": result.method, **result.errors["frame"]}
        | {"frames": [frame["frame"]["psnr"] for frame in result.frames]}
        for result in results
    ]


def proposals(folder: Path) -> dict[int, torch.Tensor]:
    """Frame number -> the picture of the large proposals, `[1, 3, H, W]`."""
    sequence = open_sequence(folder, preset=str(PROPOSALS))
    return {number: sequence[i].radiance for i, number in enumerate(sequence.numbers)}


def corrected(step: Step, path_traced: dict[int, torch.Tensor]) -> Callable:
    """A step, corrected by the large proposals of its frame."""

    def chained(frame, history):
        image, onward = step(frame, history)
        noisy = sanitise(replace(frame, radiance=path_traced[frame.number]))
        return correct(noisy, image, history, onward)

    return chained


def tables(document: dict) -> dict[str, str]:
    """Sections `mltd`, `mltd-sequences`, `mltd-ablation`, `mltd-frames` and `mltd-training`."""
    rows, costs = document["rows"], document["training"]
    methods = list(dict.fromkeys(row["method"] for row in rows))
    levels, names = sorted({row["spp"] for row in rows}), list(dict.fromkeys(row["sequence"] for row in rows))

    def mean(metric: str, **wanted) -> float:
        found = [row[metric] for row in rows if all(row[k] == v for k, v in wanted.items())]
        return float(np.mean([x for x in found if x is not None] or [np.nan]))

    main = [m for m in methods if m.partition(".")[0] not in ("summed", "concat", "alone") and ".1" not in m]
    seen = "fovvideovdp" in document["metrics"]
    head = f"| | {' | '.join(f'{spp}' for spp in levels)} | tPSNR | relMSE |" + " FovVideoVDP |" * seen
    lines = [head, "|---" * (len(levels) + 3 + seen) + "|"]
    for m in main:
        psnr = " | ".join(f"{mean('psnr_corrected', method=m, spp=spp):.2f}" for spp in levels)
        end = f" {mean('fovvideovdp', method=m):.2f} |" if seen else ""
        lines.append(f"| `{m}` | {psnr} | {mean('tpsnr', method=m):.2f} | {mean('relmse', method=m):.3f} |{end}")
    each = [f"| | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for m in main:
        psnr = " | ".join(f"{mean('psnr_corrected', method=m, sequence=name):.2f}" for name in names)
        each.append(f"| `{m}` | {psnr} |")
    ablation = ["| | PSNR, by seed | mean | tPSNR |", "|---|---|---|---|"]
    for name in (n for n in NETWORKS if not n.startswith("default")):
        seeds = [m for m in methods if m in (f"{name}.0", f"{name}.1")]
        if seeds:
            found = [mean("psnr_corrected", method=m) for m in seeds]
            smooth = np.mean([mean("tpsnr", method=m) for m in seeds])
            shown = ", ".join(f"{x:.2f}" for x in found)
            ablation.append(f"| {NETWORKS[name].what} | {shown} | {np.mean(found):.2f} | {smooth:.2f} |")
    by_frame = defaultdict(lambda: defaultdict(list))
    for row in rows:
        for i, value in enumerate(row["frames"], start=1):
            by_frame[row["method"]][i].append(value)
    numbers = sorted({i for found in by_frame.values() for i in found})
    over = [f"| frame | {' | '.join(map(str, numbers))} |", "|---" * (len(numbers) + 1) + "|"]
    over += [f"| `{m}` | {' | '.join(f'{np.mean(by_frame[m][i]):.2f}' for i in numbers)} |" for m in main]
    cost = ["| | network | steps | CPU seconds | clips |", "|---|---|---|---|---|"]
    for name, c in costs.items():
        spent = "–" if c["cpu_seconds"] is None else f"{c['cpu_seconds']:.0f}"
        cost.append(f"| `{name}` | {c['what']} | {c['steps']} | {spent} | {c['clips']} |")
    sections = {"mltd": lines, "mltd-sequences": each, "mltd-ablation": ablation, "mltd-frames": over}
    return {name: "\n".join(text) for name, text in (sections | {"mltd-training": cost}).items()}


if __name__ == "__main__":
    harness.run(main, __doc__)
