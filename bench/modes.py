"""Which mode of `denoise` for how good a picture, in how much time? One table, from the results of other scripts.

python bench/modes.py

Measures nothing: it reads the results of hybrid.py, large.py, lookahead.py and offline.py, and rewrites the table of
README.md. Each mode stands at the precision that `auto` takes on a CPU that multiplies bytes; the pictures of networks
that do not compute in bytes were measured in float32.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, ROOT, harness

# isort: split
import numpy as np

RESULT, PAGES = RESULTS / "hybrid.json", (ROOT / "README.md",)
REFERENCE = "oidn"
SMALL = {"lookahead": {"set": "standard", "spp": 1}}  # file -> which of its rows are those of small pictures
LARGE = {"lookahead": {"set": "standard720", "spp": 1}, "large": {"spp": 1}}
TIME = {"size": "720p", "precision": "bf16"}  # of what is not in bytes


@dataclass(frozen=True)
class Mode:
    """A line of the table: where its numbers stand."""

    shown: str
    small: tuple[str, str]  # file and method: small pictures
    large: tuple[str, str]  # windows of 1280×720
    needs: str = "–"


AHEAD, ALL = "two frames later", "all frames"
MODES = (
    Mode("`--model default`", ("hybrid", "default int8"), ("large", "default int8")),
    Mode("`--model hybrid-fast`", ("hybrid", "hybrid-fast int8"), ("large", "hybrid-fast int8")),
    Mode("**nothing: `hybrid`**", ("hybrid", "hybrid int8"), ("large", "hybrid int8")),
    Mode("`--lookahead 2`", ("lookahead", "hybrid-ahead2 int8"), ("lookahead", "hybrid-ahead2 int8"), AHEAD),
    Mode("`--model hybrid-large`", ("hybrid", "hybrid-large"), ("large", "hybrid-large")),
    Mode("`--model hybrid-large --lookahead 2`", ("hybrid", "hybrid-large-ahead2"), ("large", "hybrid-large-ahead2"),
         AHEAD),
    Mode("`--offline`", ("offline", "offline-without-oidn"), ("large", "offline-without-oidn"), ALL),
    Mode("`--offline`, OIDN installed", ("offline", "offline"), ("large", "offline"), ALL),
)  # fmt: skip


def main() -> None:
    harness.insert_sections(tables(json.loads(RESULT.read_text())), PAGES)


def tables(document: dict) -> dict[str, str]:
    """Section `modes`; `document` is that of hybrid.py, the others are read."""
    documents = {name: json.loads((RESULTS / f"{name}.json").read_text()) for name in ("large", "lookahead", "offline")}
    documents["hybrid"] = document
    sequences = {row["sequence"] for row in document["rows"]}
    lines = [
        "| `rtdenoise denoise` with | dB over OIDN | in windows of 1280×720 | where just uncovered | FLIP | time, CPU "
        "| needs |",
        "|---" * 7 + "|",
    ]
    for mode in MODES:
        small = [p for p in _pairs(documents, *mode.small, SMALL) if p[0]["sequence"] in sequences]
        flip = np.mean([row["frame"]["flip"] / oidn["frame"]["flip"] for row, oidn in small])
        cells = [
            f"{_lead(small, 'frame'):+.2f}", f"{_lead(_pairs(documents, *mode.large, LARGE), 'frame'):+.2f}",
            f"{_lead(small, 'uncovered'):+.2f}", f"{flip:.2f}×", f"{_time(documents, mode):.2g}×", mode.needs,
        ]  # fmt: skip
        lines.append(f"| {mode.shown} | {' | '.join(cells)} |")
    return {"modes": "\n".join(lines)}


def _pairs(documents: dict, name: str, method: str, chosen: dict[str, dict]) -> list[tuple[dict, dict]]:
    """Rows of a method in a file, each with OIDN's."""
    rows = [row for row in documents[name]["rows"] if chosen.get(name, {}).items() <= row.items()]
    oidn = {(row["sequence"], row["signal"]): row for row in rows if row["method"] == REFERENCE}
    return [(row, oidn[row["sequence"], row["signal"]]) for row in rows if row["method"] == method]


def _lead(pairs: list[tuple[dict, dict]], region: str) -> float:
    """Mean lead of corrected PSNR, of the sequences whose references are good enough to tell."""
    errors = [(a[region]["psnr_corrected"], b[region]["psnr_corrected"]) for a, b in pairs]
    return float(np.mean([ours - theirs for ours, theirs in errors if None not in (ours, theirs)]))


def _time(documents: dict, mode: Mode) -> float:
    """Time of a 720p frame as a multiple of OIDN's. Where no quiet run has timed frames ahead, they add what they add
    in the windows; the offline mode is timed on small pictures, in float32."""
    name, method = mode.small
    if name == "offline":
        return float(np.median([row["ms"] / oidn["ms"] for row, oidn in _pairs(documents, name, method, SMALL)]))
    if name == "lookahead":
        times, method = documents[name]["times"], method.replace("-ahead2", "") + " 2"
        row = next(row for row in times if row["precision"] == TIME["precision"])
        return row[method] / row[REFERENCE]
    row = next(row for row in documents[name]["times"] if TIME.items() <= row.items())
    plain = method.removesuffix("-ahead2")
    more = 1.0 if plain == method else _slower(documents, method) / _slower(documents, plain)
    return more * row[plain] / row[REFERENCE]


def _slower(documents: dict, method: str) -> float:
    """Geometric mean of a method's time over OIDN's, in the windows."""
    return float(np.exp(np.mean([np.log(a["ms"] / b["ms"]) for a, b in _pairs(documents, "large", method, LARGE)])))


if __name__ == "__main__":
    harness.run(main, __doc__)
