"""Error and time on the bundled sample: the table of the README.   python bench/sample.py"""

from __future__ import annotations

import tempfile
from pathlib import Path

import harness

from rtdenoise.evaluate.demo import METHODS, demo

RESULT = harness.ROOT / "bench" / "results" / "sample.json"
LABELS = {
    "noisy": "noisy, 1 spp",
    "accumulate": "plain accumulation",
    "oidn": "Intel OIDN 2, frame by frame",
    "paper-traditional": "rtdenoise `paper`, traditional motion",
    "paper": "rtdenoise `paper`",
    "fast": "rtdenoise `fast`",
    "default": "**rtdenoise `default`**",
    "quality": "rtdenoise `quality`",
}


def main() -> None:
    results = {}
    for signal in ("indirect", "color"):
        with tempfile.TemporaryDirectory() as folder:
            results[signal] = [
                {"method": r.method, "errors": r.errors, "median_step_ms": round(1000 * r.seconds, 1)}
                for r in demo(Path(folder), signal=signal, methods=(*METHODS, "fast", "quality", "oidn"))
            ]
    document = {**harness.origin({"torch": harness.cpu()}), "results": results}
    harness.write(RESULT, **document)
    print(table(document, "indirect"))


def table(document: dict, signal: str) -> str:
    """The rows of one signal as Markdown; time relative to ours: milliseconds of a shared CPU mean nothing."""
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
    main()
