"""Error and time on the bundled sample: the table of the README.   python bench/sample.py"""

from __future__ import annotations

import tempfile
from pathlib import Path

import harness

from rtdenoise.demo import METHODS, demo


def main() -> None:
    results = {}
    for signal in ("indirect", "color"):
        with tempfile.TemporaryDirectory() as folder:
            results[signal] = [
                {"method": r.method, "errors": r.errors, "median_step_ms": round(1000 * r.seconds, 1)}
                for r in demo(Path(folder), signal=signal, methods=(*METHODS, "oidn"))
            ]
    origin = harness.origin({"torch": harness.cpu()})
    harness.write(harness.ROOT / "bench" / "results" / "sample.json", **origin, results=results)


if __name__ == "__main__":
    main()
