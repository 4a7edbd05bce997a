"""How good are `hybrid` and its kind at more samples a pixel, with frames ahead and without?

python bench/lookahead_many.py SEQ ...    # SEQ/spp4, SEQ/spp8 ... hold the frames of SEQ at more samples

SEQ are sequences with references that no network was trained on (docs/results/large.md renders them). Writes
bench/results/lookahead_many.json and a table of docs/notes/lookahead.md. An interrupted run continues.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, ROOT, harness

# isort: split
import numpy as np
import tyro

from bench.lookahead import METRICS, PAGES, REFERENCE, SIGNALS, leads, pairs_of
from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
from rtdenoise.report.readings import label

RESULT, OUT = RESULTS / "lookahead_many.json", ROOT / "out" / "lookahead_many"
METHODS = ("hybrid", "hybrid-many", "hybrid-many-ahead2", "hybrid-large-many", "hybrid-large-many-ahead3")
IN_BYTES = ("hybrid-many",)


def main(sequences: tyro.conf.Positional[tuple[str, ...]]) -> None:
    """Measure.

    Args:
        sequences: Folders of EXR files with references, and folders of more samples.
    """
    counts = tuple(sorted({int(p.name[3:]) for s in sequences for p in Path(s).glob("spp*")}))
    rows = []
    for signal in SIGNALS:
        at = {"spp": counts, "metrics": METRICS, "signal": signal}
        run(sequences, OUT / signal, EvaluateOptions((REFERENCE, *METHODS), **at))
        for row in run(sequences, OUT / signal, EvaluateOptions(IN_BYTES, ("int8",), **at)).results:
            errors = {region: {m: row["errors"][region][m] for m in METRICS} for region in ("frame", "uncovered")}
            about = {"signal": signal, "sequence": row["sequence"], "method": label(row), "spp": row["spp"]}
            rows.append(about | errors)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `lookahead-many`: mean and least lead over OIDN, by samples."""
    rows = {(r["spp"], r["method"], r["sequence"], r["signal"]): r for r in document["rows"]}
    counts = sorted({spp for spp, *_ in rows})
    lines = [
        f"| | {' | '.join(f'{spp} spp' for spp in counts)} | {' | '.join(f'uncovered, {spp} spp' for spp in counts)} |",
        "|---" * (2 * len(counts) + 1) + "|",
    ]
    for signal, shown in zip(SIGNALS, ("beauty", "indirect light"), strict=True):
        lines.append(f"| *{shown}* |{' |' * 2 * len(counts)}")
        for method in (*METHODS, *(f"{name} int8" for name in IN_BYTES)):
            cells = []
            for region in ("frame", "uncovered"):
                for spp in counts:
                    found = leads(pairs_of(rows, spp, method, signal), region)
                    cells.append(f"{np.mean(found):+.2f}, {min(found):+.2f}")
            lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return {"lookahead-many": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
