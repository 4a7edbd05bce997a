"""The loss curve of the runs that made some weights, as JSON and as a picture.

    python bench/training_curve.py NAME RUN [RUN ...]

Several runs are those that started from one another's weights, in this order; their steps are counted on.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import harness
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from PIL import Image

LOGGED = 20  # steps between the lines of a log (rtdenoise.training.loop)


def main(name: str, runs: list[Path]) -> None:
    rows, options = [], []
    for run in runs:
        before = rows[-1]["step"] if rows else 0
        found = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
        rows += [row | {"step": before + row["step"]} for row in found]
        options.append(json.loads((run / "config.json").read_text())["options"] | {"steps_taken": found[-1]["step"]})
    steps = [row for row in rows if row.get("loss") is not None]  # null: a poisoned clip
    validation = [{"step": row["step"], **row["validation"]} for row in rows if "validation" in row]
    kept = [{k: round(row[k], 6) for k in ("step", "spatial", "temporal", "occlusion", "seconds")} for row in steps]
    harness.write(
        harness.ROOT / "bench" / "results" / f"train_{name}.json",
        **harness.origin({"torch": harness.cpu()}),
        options=options,
        hours=sum(row["seconds"] for row in steps) * LOGGED / 3600,
        validation=validation,
        log=kept[:: max(1, len(kept) // 100)],
    )

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.5), layout="constrained")
    for term in ("spatial", "temporal", "occlusion"):
        shown = [row for row in steps if row[term] > 0]
        left.plot([row["step"] for row in shown], [row[term] for row in shown], label=term, linewidth=0.8)
    left.set(xlabel="step", ylabel="L1 of the compressed radiance", yscale="log", title="training loss")
    left.legend()
    for key, label in (("denoised", "frame"), ("denoised_uncovered", "uncovered regions"), ("noisy", "noisy input")):
        right.plot([row["step"] for row in validation], [row[key] for row in validation], marker=".", label=label)
    right.set(xlabel="step", ylabel="PSNR in dB", title="validation, scenes not in training")
    right.legend()
    path = harness.ROOT / "docs" / "images" / f"train_{name}.png"
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)  # it is part of the repository
    print(f"written: {path}")


if __name__ == "__main__":
    main(sys.argv[1], [Path(argument) for argument in sys.argv[2:]])
