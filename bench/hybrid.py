"""Does a network that writes pixels pay beside one that predicts kernels?

python bench/hybrid.py SEQ ...    # sequences with references that no network was trained on

Measures OIDN, `hybrid` and the networks beside it on every sequence and both signals: over the frame and in uncovered
regions, with history and without (single frames); then the time of a step. Writes bench/results/hybrid.json and the
tables of docs/notes/hybrid.md. An interrupted run continues. With --keep-times errors alone are measured, and times
stay those of the CPU that they were measured on.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
import numpy as np
import torch
import tyro

from bench.latency.methods import partly_in_bytes, settled, stepping, synthetic_frame
from rtdenoise.baselines import Oidn
from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
from rtdenoise.models import load
from rtdenoise.models.inference import resolve
from rtdenoise.report.readings import label

RESULT, PAGES = RESULTS / "hybrid.json", (DOCS / "notes" / "hybrid.md",)
OUT = ROOT / "out" / "hybrid"
SIGNALS = ("color", "indirect")
METHODS = {
    "default-spatial": "`default`, single frames",
    "hybrid-fast-spatial": "**`hybrid-fast`**, single frames",
    "hybrid-spatial": "**`hybrid`**, single frames",
    "hybrid-large-spatial": "**`hybrid-large`**, single frames",
    "default": "`default`",
    "hybrid-fast": "**`hybrid-fast`**",
    "hybrid": "**`hybrid`**",
    "hybrid-large": "**`hybrid-large`**",
    "hybrid-large-ahead6": "**`hybrid-large`** with `--lookahead 6`",
    "default int8": "`default`, int8",
    "hybrid-fast int8": "**`hybrid-fast`**, int8",
    "hybrid int8": "**`hybrid`**, int8",
    "hybrid-ahead6 int8": "**`hybrid`** with `--lookahead 6`, int8",
    "hybrid-large int8": "**`hybrid-large`**, int8",
    "hybrid-large-ahead6 int8": "**`hybrid-large`** with `--lookahead 6`, int8",
}
IN_BYTES = tuple(method.removesuffix(" int8") for method in METHODS if method.endswith(" int8"))
ALONE = "-spatial"  # ends the names of single frames, which are not timed
AHEAD = "-ahead6"  # ends those of what sees six frames ahead
SIZES = {"720p": (720, 1280)}  # that steps are timed at
METRICS = ("psnr", "psnr_corrected", "flip", "tpsnr")


def main(sequences: tyro.conf.Positional[tuple[str, ...]], keep_times: bool = False) -> None:
    """Measure.

    Args:
        sequences: Folders of EXR files with references.
        keep_times: The times in the JSON file stay.
    """
    rows, plain = [], [method for method in METHODS if "int8" not in method]
    for signal in SIGNALS:
        run(sequences, OUT / signal, EvaluateOptions(("oidn", *plain), metrics=METRICS, signal=signal))
        options = EvaluateOptions(IN_BYTES, precisions=("int8",), metrics=METRICS, signal=signal)
        for row in run(sequences, OUT / signal, options).results:
            errors = {region: {m: row["errors"][region][m] for m in METRICS} for region in ("frame", "uncovered")}
            rows.append({"signal": signal, "sequence": row["sequence"], "method": label(row), **errors})
    times = harness.times_kept(RESULT) if keep_times else {"times": all_times()}
    harness.publish(RESULT, {"rows": rows, **times}, digits=4, pages=PAGES, tables=tables)


@torch.inference_mode()
def all_times() -> list[dict]:
    """Of every size and of each precision that the CPU has."""
    precisions = ("bf16", "fp32") if resolve("auto", "cpu") == torch.bfloat16 else ("fp32",)
    return [times_of(size, precision) for size in SIZES for precision in precisions]


def times_of(size: str, precision: str) -> dict:
    """Milliseconds of a step with history, by method; OIDN has one precision of its own, and what is not in bytes
    has this one with int8."""
    frame = synthetic_frame(*SIZES[size])
    steps = {"oidn": partial(Oidn().step, frame)}
    for method in (method for method in METHODS if not method.endswith(ALONE)):
        shown = method.removesuffix(" int8")
        name = shown.removesuffix(AHEAD)
        model = load(name, precision=precision) if shown == method else partly_in_bytes(name, precision)
        steps[method] = stepping(model, frame, settled(model, frame), 0 if name == shown else 6)
    timings = harness.measure(steps, calls=9, warmup=2)
    return {"size": size, "precision": precision, **{name: timing.median_ms for name, timing in timings.items()}}


def tables(document: dict) -> dict[str, str]:
    """Sections `hybrid`, a line a method against OIDN, and `hybrid-times`."""
    lines = [
        "| | corrected PSNR, beauty, indirect | least | uncovered | least | FLIP | tPSNR |",
        "|---" * 7 + "|",
    ]
    for method, shown in METHODS.items():
        pairs = [(row, harness.beside(document, row, "oidn")) for row in document["rows"] if row["method"] == method]
        each = [_lead(pairs, "frame", signal) for signal in SIGNALS]
        frame, uncovered = [_lead(pairs, region) for region in ("frame", "uncovered")]
        flip = np.mean([row["frame"]["flip"] / oidn["frame"]["flip"] for row, oidn in pairs])
        steady = np.mean([row["frame"]["tpsnr"] - oidn["frame"]["tpsnr"] for row, oidn in pairs])
        cells = [
            f"{np.mean(each[0]):+.2f}, {np.mean(each[1]):+.2f} dB", f"{min(frame):+.2f}", f"{np.mean(uncovered):+.2f}",
            f"{min(uncovered):+.2f}", f"{flip:.2f}×", f"{steady:+.2f}",
        ]  # fmt: skip
        lines.append(f"| {shown} | {' | '.join(cells)} |")
    return {"hybrid": "\n".join(lines), "hybrid-times": _times(document)}


def _times(document: dict) -> str:
    """Times as multiples of OIDN's."""
    names = [name for name in METHODS if name in document["times"][0]]
    lines = [f"| {' | '.join(['', *(METHODS[name] for name in names)])} |", "|---" * (len(names) + 1) + "|"]
    for row in document["times"]:
        cells = [f"{row[name] / row['oidn']:.2f}×" for name in names]
        lines.append(f"| {row['size']}, {row['precision']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _lead(pairs: list[tuple[dict, dict]], region: str, signal: str = "") -> list[float]:
    """Corrected PSNR less OIDN's, of the sequences whose references are good enough to tell."""
    errors = [(a[region]["psnr_corrected"], b[region]["psnr_corrected"]) for a, b in pairs if signal in a["signal"]]
    return [ours - theirs for ours, theirs in errors if None not in (ours, theirs)]


if __name__ == "__main__":
    harness.run(main, __doc__)
