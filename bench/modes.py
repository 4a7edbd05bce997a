"""Which mode of `denoise` for how good a picture, in how much time? One table, from the results of other scripts.

python bench/modes.py

Measures nothing: it reads the results of hybrid.py and offline.py, in windows of 1280×720 those of lookahead.py, and,
on a GPU, of latency_720p.py, and rewrites the table of README.md. Each mode stands at the precision that `auto` takes
on a CPU that multiplies bytes.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, ROOT, harness
from bench.latency.tables import TOTAL

# isort: split
import numpy as np

RESULT, PAGES = RESULTS / "hybrid.json", (ROOT / "README.md",)
REFERENCE, INT8 = "oidn", " int8"
READ = "lookahead", "offline", "latency_720p_cuda"
LARGE = "standard720"  # the windows in what lookahead.py measured
TIME = {"size": "720p", "precision": "bf16"}  # of what is not in bytes


@dataclass(frozen=True)
class Mode:
    """A line of the table."""

    shown: str
    method: str
    needs: str = "–"


AHEAD, ALL = "six frames later", "all frames"
MODES = (
    Mode("`--model default`", "default int8"),
    Mode("`--model hybrid-fast --lookahead 0`", "hybrid-fast int8"),
    Mode("`--lookahead 0`: `hybrid` in real time", "hybrid int8"),
    Mode("**nothing: `hybrid`, six frames ahead**", "hybrid-ahead6 int8", AHEAD),
    Mode("`--model hybrid-large --lookahead 0`", "hybrid-large int8"),
    Mode("`--model hybrid-large`", "hybrid-large-ahead6 int8", AHEAD),
    Mode("`--offline`", "offline-without-oidn", ALL),
    Mode("`--offline`, OIDN installed", "offline", ALL),
)


def main() -> None:
    harness.insert_sections(tables(harness.read(RESULT)), PAGES)


def tables(document: dict) -> dict[str, str]:
    """Section `modes`; `document` is that of hybrid.py, the others are read."""
    large, offline, gpu = (harness.read(RESULTS / f"{name}.json") for name in READ)
    large = {"rows": [row for row in large["rows"] if row["set"] == LARGE]}
    sequences = {row["sequence"] for row in document["rows"]}
    lines = [
        "| `rtdenoise denoise` with | dB over OIDN | in windows of 1280×720 | where just uncovered | FLIP | time, CPU "
        "| time, GPU | needs |",
        "|---" * 8 + "|",
    ]
    for mode in MODES:
        small = _pairs(offline if mode.needs == ALL else document, mode.method)
        small = [pair for pair in small if pair[0]["sequence"] in sequences]
        flip = np.mean([row["frame"]["flip"] / oidn["frame"]["flip"] for row, oidn in small])
        cells = [
            f"{_lead(small, 'frame'):+.2f}",
            f"{_lead(_pairs(large, mode.method), 'frame'):+.2f}",
            f"{_lead(small, 'uncovered'):+.2f}", f"{flip:.2f}×", f"{_time(document, small, mode):.2g}×",
            _on_gpu(gpu, mode), mode.needs,
        ]  # fmt: skip
        lines.append(f"| {mode.shown} | {' | '.join(cells)} |")
    return {"modes": "\n".join(lines)}


def _pairs(document: dict, method: str) -> list[tuple[dict, dict]]:
    """Rows of a method at 1 sample, each with OIDN's."""
    rows = [row for row in document["rows"] if row.get("spp", 1) == 1]
    oidn = {(row["sequence"], row["signal"]): row for row in rows if row["method"] == REFERENCE}
    return [(row, oidn[row["sequence"], row["signal"]]) for row in rows if row["method"] == method]


def _lead(pairs: list[tuple[dict, dict]], region: str) -> float:
    """Mean lead of corrected PSNR, of the sequences whose references are good enough to tell."""
    errors = [(a[region]["psnr_corrected"], b[region]["psnr_corrected"]) for a, b in pairs]
    return float(np.mean([ours - theirs for ours, theirs in errors if None not in (ours, theirs)]))


def _time(document: dict, small: list[tuple[dict, dict]], mode: Mode) -> float:
    """Time of a 720p frame as a multiple of OIDN's; the offline mode is timed on small pictures, in float32."""
    if mode.needs == ALL:
        return float(np.median([row["ms"] / oidn["ms"] for row, oidn in small]))
    row = next(row for row in document["times"] if TIME.items() <= row.items())
    return row[mode.method] / row[REFERENCE]


def _on_gpu(gpu: dict, mode: Mode) -> str:
    """Milliseconds of a 720p frame, as a recorded step in bfloat16."""
    name = f"{mode.method.removesuffix(INT8)} fused bf16, graph"
    rows = [row for row in gpu["rows"] if (row["size"], row["method"]) == ("720p", name)]
    return f"{rows[0][TOTAL]['median_ms']:.1f} ms" if rows else "–"


if __name__ == "__main__":
    harness.run(main, __doc__)
