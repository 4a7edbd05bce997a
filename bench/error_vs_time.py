"""Error against time on the standard set: methods on indirect light, as one report. Ablations and combiners have pages
of their own (docs/results/quality.md, combine.md).

python bench/error_vs_time.py [SEQ ...]    # the standard set, and sequences of your own
python bench/error_vs_time.py --quick      # four frames of the bundled sequence: renders and keeps nothing

Renders missing sequences into data/standard, measures into out/standard (an interrupted run continues), and writes
bench/results/error_vs_time.json and docs/results/report.{md,png}; the page with pictures stays in out/standard. No
model was trained on these scenes. Inputs at 2, 4 and 8 samples per pixel share the references of those at 1.
"""

from __future__ import annotations

import shutil
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, SAMPLE, harness
from bench.harness import standard

# isort: split
import tyro

from rtdenoise.evaluate import REGIONS
from rtdenoise.evaluate import run as evaluation
from rtdenoise.evaluate.document import Document
from rtdenoise.models import available
from rtdenoise.report import report

OUT = ROOT / "out" / "standard"
RESULT = RESULTS / "error_vs_time.json"
AT_1_SPP = ("noisy", "accumulate", "accumulate-clamped", "svgf", "trmv", "oidn", "oidn-fast", "oidn-prefiltered",
            "oidn-then-accumulated", "paper", "fast", "default", "hybrid-fast", "hybrid", "offline")  # fmt: skip
OVER_SPP = ("noisy", "accumulate", "oidn-fast", "oidn", "oidn-prefiltered", *available())


@dataclass(frozen=True)
class Options:
    sequences: tyro.conf.Positional[tuple[str, ...]] = ()
    """More sequences to measure, of your own."""
    quick: bool = False
    """Four frames of the bundled sequence; nothing is rendered and nothing kept."""


def main(o: Options) -> None:
    started = time.perf_counter()
    out = ROOT / "out" / "quick" if o.quick else OUT
    if o.quick:
        evaluation.run([str(SAMPLE)], out, evaluation.EvaluateOptions(OVER_SPP, signal="indirect", frames=4))
    else:
        folders = standard.prepare()
        standard.add_samples()
        at_1_spp = evaluation.EvaluateOptions(AT_1_SPP, precisions=("fp32", "bf16", "int8"), signal="indirect")
        evaluation.run([*folders, *o.sequences], out, at_1_spp)
        evaluation.run(folders, out, evaluation.EvaluateOptions(OVER_SPP, spp=standard.SPP, signal="indirect"))
    written = report(out)
    if not o.quick:
        keep(out)
    print(f"{', '.join(str(path) for path in written)}; {time.perf_counter() - started:.0f} s")


def keep(out: Path) -> None:
    """The numbers of whole sequences into bench/results, the report without its pictures into docs."""
    for suffix in (".md", ".png"):
        shutil.copy(out / f"report{suffix}", DOCS / "results" / f"report{suffix}")
    document = vars(Document.read(out))
    document["results"] = [
        {k: v for k, v in row.items() if k != "frames"} | {"errors": {r: row["errors"][r] for r in REGIONS}}
        for row in document["results"]
    ]
    harness.publish(RESULT, document, digits=5)


if __name__ == "__main__":
    harness.run(main, __doc__)
