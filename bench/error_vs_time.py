"""Error against time on the standard set: every method, indirect light, as one report.

    python bench/error_vs_time.py [SEQ ...]  renders what is missing into data/standard, measures it, and sequences of
                                             one's own, into out/standard, and keeps numbers and report:
                                             bench/results, docs/report
    python bench/error_vs_time.py --quick    four frames of the sample, nothing rendered, nothing kept: for CI

No model was trained on these scenes (standard.py). Inputs at 2, 4 and 8 samples per pixel are rendered like those at 1
and share their references. Interrupted runs go on where they stopped.
"""

from __future__ import annotations

import shutil
import sys
import time
from pathlib import Path

import harness
import standard

from rtdenoise.evaluate import REGIONS
from rtdenoise.evaluate.document import Document
from rtdenoise.evaluate.run import Options, run
from rtdenoise.models import available
from rtdenoise.report import report

OUT = harness.ROOT / "out" / "standard"
RESULT, KEPT = harness.ROOT / "bench" / "results" / "error_vs_time.json", harness.ROOT / "docs" / "report"
OVER_SPP = ("noisy", "accumulate", "oidn-fast", "oidn", "oidn-prefiltered", *available())
# The page is part of the repository, so it has pictures, beside references, of these alone.
PICTURES, SHOWN = ("oidn", "default"), ("mural",)


def main(quick: bool, more: list[str]) -> None:
    started = time.perf_counter()
    if quick:
        sequences, out = [harness.ROOT / "samples" / "mural"], harness.ROOT / "out" / "quick"
        run([str(s) for s in sequences], out, Options(OVER_SPP, signal="indirect", frames=4))
    else:
        folders, out = standard.prepare(), OUT
        standard.add_samples()
        run(folders + more, out, Options(precisions=("fp32", "bf16"), signal="indirect"))
        run(folders, out, Options(OVER_SPP, spp=standard.SPP, signal="indirect"))
    written = report(out) if quick else report(out, PICTURES, SHOWN)
    if not quick:
        keep(out, written)
    print(f"{', '.join(str(path) for path in written)}; {time.perf_counter() - started:.0f} s")


def keep(out: Path, written: list[Path]) -> None:
    """The numbers into bench/results (in five digits, of whole sequences, over the frame and in what was just
    uncovered), the report into docs."""
    KEPT.mkdir(parents=True, exist_ok=True)
    for path in written:
        shutil.copy(path, KEPT / path.name)
    document = vars(Document.read(out))
    document["results"] = [
        {k: v for k, v in row.items() if k != "frames"} | {"errors": {r: row["errors"][r] for r in REGIONS}}
        for row in document["results"]
    ]
    harness.write(RESULT, digits=5, **(harness.origin({"torch": harness.cpu()}) | document))


if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:], more=[folder for folder in sys.argv[1:] if folder != "--quick"])
