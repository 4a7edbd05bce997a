"""Does a network that writes pixels pay beside one that predicts kernels?

python bench/hybrid.py SEQ ...    # sequences with references that no network was trained on

Measures OIDN, `hybrid` and the networks beside it on every sequence and both signals: over the frame and in uncovered
regions, with history and without (single frames), and the time of each. Writes bench/results/hybrid.json and the table
of docs/notes/hybrid.md. An interrupted run continues.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
import numpy as np
import tyro

from rtdenoise.evaluate.run import EvaluateOptions, run

RESULT, PAGES = RESULTS / "hybrid.json", (DOCS / "notes" / "hybrid.md",)
OUT = ROOT / "out" / "hybrid"
SIGNALS = ("color", "indirect")
METHODS = {
    "default-spatial": "`default`, single frames",
    "quality-spatial": "`quality`, single frames",
    "hybrid-spatial": "**`hybrid`**, single frames",
    "default": "`default`",
    "quality": "`quality`",
    "default-oidn": "`default` with `--oidn`",
    "hybrid": "**`hybrid`**",
}
METRICS = ("psnr", "psnr_corrected", "flip", "tpsnr")


def main(sequences: tyro.conf.Positional[tuple[str, ...]]) -> None:
    """Measure.

    Args:
        sequences: Folders of EXR files with references.
    """
    rows = []
    for signal in SIGNALS:
        options = EvaluateOptions(("oidn", *METHODS), metrics=METRICS, signal=signal)
        for row in run(sequences, OUT / signal, options).results:
            errors = {region: {m: row["errors"][region][m] for m in METRICS} for region in ("frame", "uncovered")}
            facts = {key: row[key] for key in ("sequence", "method", "precision")}
            rows.append({"signal": signal, **facts, "ms": row["ms"]["median"], **errors})
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `hybrid`: a line a method, against OIDN."""
    lines = [
        "| | corrected PSNR, beauty, indirect | least | uncovered | least | FLIP | tPSNR | OIDN's time |",
        "|---" * 8 + "|",
    ]
    for method, shown in METHODS.items():
        pairs = [(row, _oidn(document, row)) for row in document["rows"] if row["method"] == method]
        each = [_lead(pairs, "frame", signal) for signal in SIGNALS]
        frame, uncovered = [_lead(pairs, region) for region in ("frame", "uncovered")]
        flip = np.mean([row["frame"]["flip"] / oidn["frame"]["flip"] for row, oidn in pairs])
        steady = np.mean([row["frame"]["tpsnr"] - oidn["frame"]["tpsnr"] for row, oidn in pairs])
        cells = [
            f"{np.mean(each[0]):+.2f}, {np.mean(each[1]):+.2f} dB", f"{min(frame):+.2f}", f"{np.mean(uncovered):+.2f}",
            f"{min(uncovered):+.2f}", f"{flip:.2f}×", f"{steady:+.2f}",
            f"{np.median([row['ms'] / oidn['ms'] for row, oidn in pairs]):.2f}×",
        ]  # fmt: skip
        lines.append(f"| {shown} | {' | '.join(cells)} |")
    return {"hybrid": "\n".join(lines)}


def _oidn(document: dict, like: dict) -> dict:
    same = ((row["sequence"], row["signal"]) == (like["sequence"], like["signal"]) for row in document["rows"])
    return next(row for row, it in zip(document["rows"], same, strict=True) if it and row["method"] == "oidn")


def _lead(pairs: list[tuple[dict, dict]], region: str, signal: str = "") -> list[float]:
    """Corrected PSNR less OIDN's, of the sequences whose references are good enough to tell."""
    errors = [(a[region]["psnr_corrected"], b[region]["psnr_corrected"]) for a, b in pairs if signal in a["signal"]]
    return [ours - theirs for ours, theirs in errors if None not in (ours, theirs)]


if __name__ == "__main__":
    harness.run(main, __doc__)
