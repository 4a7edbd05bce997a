"""What is it worth to OIDN's opinion in real time that OIDN denoises albedo and normal first?

python bench/prefilter.py SEQ ...    # sequences with references that no network was trained on

Measures `denoise --oidn` with and without `--prefilter`, and with two frames ahead, in the first eight frames of each
sequence at 1 sample, both signals. Sequences are told apart by the folder that they lie in. Then the time of a step.
Writes bench/results/prefilter.json and the tables of docs/notes/opinion.md. An interrupted run continues.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
import numpy as np
import torch
import tyro

from bench.latency.methods import synthetic_frame
from rtdenoise.baselines import Oidn
from rtdenoise.evaluate.registry import choose
from rtdenoise.evaluate.run import EvaluateOptions, run
from rtdenoise.models.inference import resolve
from rtdenoise.run.opinion import RECENT

RESULT, PAGES = RESULTS / "prefilter.json", (DOCS / "notes" / "opinion.md",)
OUT = ROOT / "out" / "prefilter"
SIGNALS, FRAMES = ("color", "indirect"), 8
REFERENCE = "oidn"
METHODS = ("hybrid", "default-oidn", "default-oidn-prefiltered", "default-oidn-prefiltered-ahead2")
TIMED = METHODS[1:3]
METRICS = ("psnr_corrected", "flip")
SETS = {"standard720": "windows of 1280×720", "standard": "small pictures"}


def main(sequences: tyro.conf.Positional[tuple[str, ...]]) -> None:
    """Measure.

    Args:
        sequences: Folders of EXR files with references.
    """
    rows = []
    for sequence in sequences:
        where = Path(sequence).resolve().parent.name
        for signal in SIGNALS:
            options = EvaluateOptions((REFERENCE, *METHODS), metrics=METRICS, signal=signal, frames=FRAMES)
            for row in run([sequence], OUT / where / Path(sequence).name / signal, options).results:
                errors = {region: {m: row["errors"][region][m] for m in METRICS} for region in ("frame", "uncovered")}
                rows.append({"set": where, "signal": signal, "sequence": row["sequence"], "method": row["method"],
                             **errors})  # fmt: skip
    precision = "bf16" if resolve("auto", "cpu") == torch.bfloat16 else "fp32"
    with torch.inference_mode():
        times = times_of(precision)
    harness.publish(RESULT, {"rows": rows, "times": times}, digits=4, pages=PAGES, tables=tables)


def times_of(precision: str) -> dict:
    """Milliseconds of a step with history at 720p, by method."""
    frame = synthetic_frame(720, 1280)
    steps = {REFERENCE: partial(Oidn().step, frame)}
    for method in choose(TIMED):
        step = method.step("cpu", precision)
        history = step(frame, None)[1]
        steps[method.name] = partial(step, frame, replace(history, recent=history.recent * RECENT))
    timings = harness.measure(steps, calls=5, warmup=1)
    return {"precision": precision, **{name: timing.median_ms for name, timing in timings.items()}}


def tables(document: dict) -> dict[str, str]:
    """Section `prefilter`: each method over OIDN, mean and least of all pairs of sequence and signal."""
    rows = {(r["set"], r["method"], r["sequence"], r["signal"]): r for r in document["rows"]}
    lines = ["| | beauty, indirect light | least | uncovered | least | FLIP | OIDN's time |", "|---" * 7 + "|"]
    for where, shown in SETS.items():
        lines.append(f"| *{shown}* | | | | | | |")
        for method in METHODS:
            found = [key for key in rows if key[:2] == (where, method)]
            pairs = {key[2:]: (rows[key], rows[(where, REFERENCE, *key[2:])]) for key in found}
            frame = {key: _lead(*pair, "frame") for key, pair in pairs.items()}
            each = [np.mean([x for (_, of), x in frame.items() if of == signal]) for signal in SIGNALS]
            uncovered = [x for pair in pairs.values() if (x := _lead(*pair, "uncovered")) is not None]
            flip = np.mean([a["frame"]["flip"] / b["frame"]["flip"] for a, b in pairs.values()])
            time = document["times"].get(method)
            times = f"{time / document['times'][REFERENCE]:.1f}×" if time else ""
            cells = f"{min(frame.values()):+.2f} | {np.mean(uncovered):+.2f} | {min(uncovered):+.2f} | {flip:.2f}×"
            lines.append(f"| `{method}` | {each[0]:+.2f}, {each[1]:+.2f} dB | {cells} | {times} |")
    return {"prefilter": "\n".join(lines)}


def _lead(ours: dict, theirs: dict, region: str) -> float | None:
    a, b = (row[region]["psnr_corrected"] for row in (ours, theirs))
    return None if None in (a, b) else a - b


if __name__ == "__main__":
    harness.run(main, __doc__)
