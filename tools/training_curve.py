"""Publish the log of the runs that made some weights: bench/results/train_NAME.json and docs/images/train_NAME.webp.

python tools/training_curve.py NAME RUN [RUN ...]

Each run started from the weights of the run before it; their steps are counted through.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro
from matplotlib.figure import Figure
from PIL import Image

LOGGED = 20  # steps between two lines of a log (rtdenoise.training.loop)
KEPT = 100  # lines of the log in the result, about
TERMS = ("spatial", "temporal", "occlusion")  # of the loss
COLOURS = 64  # of the picture: the repository holds it


def main(
    name: tyro.conf.Positional[str], run: tyro.conf.Positional[Path], more: tyro.conf.Positional[tuple[Path, ...]] = ()
) -> None:
    rows, options = join([run, *more])
    steps = [row for row in rows if row.get("loss") is not None]  # null: the loss was not finite
    validation = [{"step": row["step"], **row["validation"]} for row in rows if "validation" in row]
    kept = [{k: round(row[k], 6) for k in ("step", *TERMS, "seconds")} for row in steps]
    content = {
        "options": options,
        "hours": sum(row["seconds"] for row in steps) * LOGGED / 3600,
        "validation": validation,
        "log": kept[:: max(1, len(kept) // KEPT)],
    }
    harness.publish(RESULTS / f"train_{name}.json", content)
    draw(steps, validation, DOCS / "images" / f"train_{name}.webp")


def join(runs: list[Path]) -> tuple[list[dict], list[dict]]:
    """The lines of all logs, steps counted through, and the options of each run."""
    rows: list[dict] = []
    options = []
    for run in runs:
        before = rows[-1]["step"] if rows else 0
        found = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
        rows += [row | {"step": before + row["step"]} for row in found]
        options.append(json.loads((run / "config.json").read_text())["options"] | {"steps_taken": found[-1]["step"]})
    return rows, options


def draw(steps: list[dict], validation: list[dict], path: Path) -> None:
    """The terms of the loss, and the PSNR on validation clips."""
    figure = Figure(figsize=(10, 3.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for term in TERMS:
        shown = [row for row in steps if row[term] > 0]
        left.plot([row["step"] for row in shown], [row[term] for row in shown], label=term, linewidth=0.8)
    left.set(xlabel="step", ylabel="L1 of the compressed radiance", yscale="log", title="training loss")
    left.legend()
    for key, label in (("denoised", "frame"), ("denoised_uncovered", "uncovered regions"), ("noisy", "noisy input")):
        right.plot([row["step"] for row in validation], [row[key] for row in validation], marker=".", label=label)
    right.set(xlabel="step", ylabel="PSNR in dB", title="validation, scenes not in training")
    right.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    Image.open(path).convert("RGB").quantize(COLOURS).convert("RGB").save(path, lossless=True, quality=100, method=6)
    print(f"written: {path}")


if __name__ == "__main__":
    harness.run(main, __doc__)
