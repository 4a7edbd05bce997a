"""The networks of the papers against `combiner`: python bench/combine_papers.py CLIPS ... --drc FILE --dc FILE

Both are trained on clips of `combine_clips.py` with estimates of `oidn` and `default`, `drc` by `rtdenoise train
--model drc`, `dc` by `bench/deep_combiner.py`. CLIPS and the errors are those of `combine.py`. Writes
bench/results/combine_papers.json and a table of docs/results/combine.md.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import tyro

from bench.combine import loaded, measure, summary

RESULT, PAGES = RESULTS / "combine_papers.json", (DOCS / "results" / "combine.md",)
LEVELS = (1, 4, 16, 64)
METHODS = ("oidn", "default", "svgf")
SHOWN = ("shrinkage", "combiner", "drc", "dc")


def main(clips: tyro.conf.Positional[tuple[Path, ...]], drc: Path, dc: Path) -> None:
    """Measure.

    Args:
        clips: Folders, each with a folder of clips for each sample count.
        drc: Weights of the deep residual combiner.
        dc: Weights of the deep combiner.
    """
    networks = dict(map(loaded, ("combiner", f"drc={drc}", f"dc={dc}")))
    rows = [row for folder in clips for row in measure(folder, METHODS, networks, LEVELS)]
    harness.publish(RESULT, {"rows": rows, "summary": summary(rows)}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `combine-papers`: error over z's by sample count and denoiser, and that of differences in time."""
    each = [*(f"{spp} spp" for spp in LEVELS), *(f"`{z}`" for z in METHODS)]
    lines = [
        f"| combiner | {' | '.join(each)} | all | worst | failures | change between frames |",
        "|---" * (len(LEVELS) + len(METHODS) + 5) + "|",
    ]
    for name in SHOWN:
        found = document["summary"][name]
        ratios = [*(found["by_spp"][str(spp)] for spp in LEVELS), *(found["by_method"][z] for z in METHODS)]
        cells = [f"{ratio:.3f}" for ratio in (*ratios, found["ratio"], found["worst"]["ratio"])]
        failures = f"{found['failures']} of {found['cells']}"
        lines.append(f"| `{name}` | {' | '.join(cells)} | {failures} | {found['temporal']:.3f} |")
    return {"combine-papers": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
