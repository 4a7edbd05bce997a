"""Rewrite the tables of all pages from bench/results, without measuring anything.

python bench/tables.py
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import harness

# isort: split

# Each has RESULT, a JSON file (some OTHER_RESULTS beside it); PAGES, the pages with its sections; and tables(document)
# -> section -> Markdown.
MODULES = (
    "ablation", "attacks", "attention", "attention_cost", "combine", "combine_ablation", "combine_cycles",
    "combine_papers", "cycles", "files", "held", "hybrid", "large", "latency_720p", "lookahead", "lookahead_many",
    "metropolis", "missing_layers", "mltd", "mltd_memory", "modes", "offline", "plan", "quality", "sample", "shots",
    "stability", "tiles", "whole_run", "calibration.cuts", "diagnosis.activity", "diagnosis.advance", "diagnosis.alpha",
    "diagnosis.bias", "diagnosis.changed", "diagnosis.clean", "diagnosis.clean_input", "diagnosis.divisor",
    "diagnosis.evened", "diagnosis.exposure", "diagnosis.extremes", "diagnosis.fireflies", "diagnosis.fog",
    "diagnosis.generalisation", "diagnosis.ideal_history", "diagnosis.learning_curve", "diagnosis.leftover",
    "diagnosis.lens", "diagnosis.lost", "diagnosis.many", "diagnosis.motion_blur", "diagnosis.outdated",
    "diagnosis.panorama", "diagnosis.retextured", "diagnosis.scattered", "diagnosis.shadows", "diagnosis.soft_edges",
    "diagnosis.trusted", "diagnosis.turned", "diagnosis.virtual_motion", "diagnosis.where", "diagnosis.white",
)  # fmt: skip


def main() -> None:
    for name in MODULES:
        bench = importlib.import_module(f"bench.{name}")
        for result in (bench.RESULT, *getattr(bench, "OTHER_RESULTS", ())):
            harness.insert_sections(bench.tables(harness.read(result)), bench.PAGES)


if __name__ == "__main__":
    harness.run(main, __doc__)
