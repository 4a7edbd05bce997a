"""Error and time of every method on the bundled sequence: the table of the README.

python bench/sample.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split

from rtdenoise.evaluate.demo import METHODS, demo

RESULT = RESULTS / "sample.json"
PAGES = (ROOT / "README.md", DOCS / "reference" / "models" / "default.md")
SIGNALS = ("indirect", "color")
LABELS = {
    "noisy": "noisy, 1 spp",
    "accumulate": "plain accumulation",
    "oidn": "Intel OIDN 2, frame by frame",
    "paper-traditional": "rtdenoise `paper`, traditional motion",
    "paper": "rtdenoise `paper`",
    "fast": "rtdenoise `fast`",
    "default": "rtdenoise `default`",
    "hybrid": "**rtdenoise `hybrid`**",
}


def main() -> None:
    results = {}
    for signal in SIGNALS:
        with tempfile.TemporaryDirectory() as folder:
            results[signal] = [
                {"method": r.method, "errors": r.errors, "median_step_ms": round(1000 * r.seconds, 1)}
                for r in demo(Path(folder), signal=signal, methods=(*METHODS, "fast", "oidn"))
            ]
    harness.publish(RESULT, {"results": results}, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Sections `sample-indirect` and `sample-color`: errors, and times relative to `default` (milliseconds of a shared
    CPU mean nothing)."""
    return {f"sample-{signal}": table(document, signal) for signal in SIGNALS}


def table(document: dict, signal: str) -> str:
    """All methods on one signal."""
    rows = {row["method"]: row for row in document["results"][signal]}
    ours = rows["default"]["median_step_ms"]
    lines = [
        "| | PSNR | SSIM | relMSE | PSNR, uncovered | SSIM, uncovered | relMSE, uncovered | time |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for method, label in LABELS.items():
        frame, uncovered = (rows[method]["errors"][region] for region in ("frame", "uncovered"))
        cells = [f"{e['psnr']:.2f} | {e['ssim']:.3f} | {e['relmse']:.3f}" for e in (frame, uncovered)]
        time = rows[method]["median_step_ms"] / ours
        lines.append(f"| {label} | {cells[0]} | {cells[1]} | {f'{time:.2f}×' if method != 'noisy' else '–'} |")
    return "\n".join(lines)


if __name__ == "__main__":
    harness.run(main, __doc__)
