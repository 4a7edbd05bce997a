"""Quality of every denoiser on sequences that no model was trained on: both signals, over the whole frame and in
uncovered regions, with a strip of pictures of each.

python bench/quality.py [SEQ ...]    # the standard set, and sequences of your own

Renders what is missing of the standard set, measures into out/quality, and writes bench/results/quality.json, the
tables of docs/results/quality.md and docs/images/quality/SEQ-SIGNAL.webp. Results are reused unless their input or
weights have changed. `sh tools/train_weights.sh settings` trains the paper's settings A, B and C; a setting whose
weights are not there keeps the rows that the JSON has of it, under the run that measured them.
FovVideoVDP is measured where pyfvvdp is installed.
"""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness
from bench.harness import standard, strips

# isort: split
import tyro

from rtdenoise.evaluate.document import Document
from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
from rtdenoise.report.markdown import write_number
from rtdenoise.report.readings import METRICS, cost

OUT, PICTURES = ROOT / "out" / "quality", DOCS / "images" / "quality"
RESULT, PAGES = RESULTS / "quality.json", (DOCS / "results" / "quality.md",)
SIGNALS = ("indirect", "color")
LABELS = {
    "noisy": "noisy, 1 spp",
    "accumulate": "plain accumulation",
    "svgf": "SVGF",
    "oidn": "OIDN",
    "oidn-prefiltered": "OIDN, prefiltered",
    "A": "A: traditional motion",
    "B": "B: dual motion",
    "C": "C: B and the occlusion loss",
    "paper": "`paper`, as it ships",
    "fast": "`fast`",
    "default": "`default`",
    "hybrid": "**`hybrid`**",
    "hybrid-ahead2": "**`hybrid`** with `--lookahead 2`",
}
# Weights of the paper's settings, which do not ship. Relative to the current folder, because legends show the path.
SETTINGS = {n: os.path.relpath(ROOT / f"runs/paper-{n}/weights.safetensors") for n in "ABC"}
OF_FRAME = ("psnr", "psnr_corrected", "ssim", "relmse", "flip", "tpsnr", "fovvideovdp")
OF_UNCOVERED = OF_FRAME[:-1]
REGIONS = ("frame", "uncovered")
MEASURED = (*OF_FRAME[:-1], "mse", "mse_corrected")


def main(sequences: tyro.conf.Positional[tuple[str, ...]] = ()) -> None:
    started = time.perf_counter()
    kept = [name for name, file in SETTINGS.items() if not Path(file).is_file()]
    if kept:
        print(f"{', '.join(kept)}: no weights, rows are kept; sh tools/train_weights.sh settings trains them")
    folders = [*standard.prepare(), *sequences]
    measured = (*MEASURED, "fovvideovdp") if importlib.util.find_spec("pyfvvdp") else MEASURED
    chosen = tuple(f"{name}={SETTINGS[name]}" if name in SETTINGS else name for name in LABELS if name not in kept)
    documents = {}
    for signal in SIGNALS:
        documents[signal] = run(folders, OUT / signal, EvaluateOptions(chosen, metrics=measured, signal=signal))
    draw(documents)
    before = harness.read(RESULT) if kept else {}
    harness.publish(RESULT, keep(summary(documents), before, kept), digits=5, pages=PAGES, tables=tables)
    print(f"{time.perf_counter() - started:.0f} s")


def summary(documents: dict[str, Document]) -> dict:
    """The numbers behind the tables: signal -> facts of each sequence, and a row per signal, sequence and method."""
    facts = ("size", "frames", "uncovered_share", "exposure", "reference_psnr", "reference_relmse")
    return {
        "runs": {signal: document.runs for signal, document in documents.items()},
        "sequences": {
            signal: {
                name: {fact: sequence[fact] for fact in facts} | {"frames": len(sequence["frames"])}
                for name, sequence in document.sequences.items()
            }
            for signal, document in documents.items()
        },
        "rows": [
            {
                "signal": signal, "sequence": row["sequence"], "method": row["method"], "run": row["run"],
                "frame": row["errors"]["frame"], "uncovered": row["errors"]["uncovered"],
                "ghost_length": row["ghost_length"], "ms": row["ms"]["median"],
            }
            for signal, document in documents.items()
            for row in document.results
        ],
    }  # fmt: skip


def keep(document: dict, before: dict, methods: Sequence[str]) -> dict:
    """`document` with the rows of `methods` on the same sequences from a document before, and the runs of these."""
    for signal in SIGNALS if methods else ():
        runs = document["runs"][signal]
        first = len(runs)
        runs += before["runs"][signal]
        document["rows"] += [
            row | {"run": first + row["run"]}
            for row in before["rows"]
            if row["signal"] == signal and row["method"] in methods and row["sequence"] in document["sequences"][signal]
        ]
    return document


def draw(documents: dict[str, Document]) -> None:
    """Write the strips into docs/images."""
    for signal, document in documents.items():
        for name, sequence in document.sequences.items():
            shown = {"noisy": "noisy", "OIDN": "oidn", "default": "default", "hybrid": "hybrid"}
            strips.draw(OUT / signal, name, sequence, shown, PICTURES / f"{name}-{signal}.webp")


# --- tables -----------------------------------------------------------------------------------------------------------


def tables(document: dict) -> dict[str, str]:
    """Sections `against` peers, `settings` of the paper, `aims`, and `scenes`: a table per sequence and signal."""
    ahead = {
        "against": _against(document, "hybrid", "oidn"),
        "against-prefiltered": _against(document, "hybrid", "oidn-prefiltered"),
        "against-ahead": _against(document, "hybrid-ahead2", "oidn"),
        "against-default": _against(document, "default", "oidn"),
        "against-fast": _against(document, "fast", "oidn"),
    }
    return {**ahead, "settings": _settings(document), "aims": _aims(document), "scenes": "\n\n".join(_scenes(document))}


def _against(document: dict, model: str, peer: str) -> str:
    """How `model` compares with `peer`, by metric."""
    return _gains(document, " ", [(METRICS[metric].label, model, peer, metric) for metric in OF_FRAME])


def _settings(document: dict) -> str:
    """Gain of each setting of the paper over the one before, and of `default` and `hybrid` over C."""
    pairs = [
        ("B over A", "B", "A"), ("C over B", "C", "B"), ("C over `paper` as it ships", "C", "paper"),
        ("`default` over C", "default", "C"), ("`hybrid` over C", "hybrid", "C"),
    ]  # fmt: skip
    return _gains(document, " corrected PSNR ", [(*pair, "psnr_corrected") for pair in pairs])


def _gains(document: dict, head: str, rows: list[tuple[str, str, str, str]]) -> str:
    """A line for each (label, model, peer, metric)."""
    lines = [f"|{head}| ahead, frame | on average, frame | ahead, uncovered | on average, uncovered |"]
    lines.append("|---" * 5 + "|")
    for label, model, peer, metric in rows:
        cells = [cell for region in REGIONS for cell in _gain(document, model, peer, region, metric)]
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _gain(document: dict, model: str, peer: str, region: str, metric: str) -> tuple[str, str]:
    """On how many sequences and signals `model` is ahead of `peer`, and by how much on average."""
    both = [_rows(document, signal, name) for signal in SIGNALS for name in document["sequences"].get(signal, ())]
    both = [rows for rows in both if {model, peer} <= rows.keys()]
    values = [[rows[method][region].get(metric) for method in (model, peer)] for rows in both]
    gains = [a - b for a, b in values if a is not None and b is not None]
    if not gains:
        return "–", "–"
    better = sum(g > 0 if METRICS[metric].higher else g < 0 for g in gains)
    mean = write_number(metric, sum(gains) / len(gains))
    return f"{better} of {len(gains)}", mean if mean.startswith("-") else f"+{mean}"


def _aims(document: dict) -> str:
    """Gains of `hybrid` over OIDN and over setting A on every sequence."""
    lines = [
        "| | signal | PSNR over OIDN's | corrected PSNR over OIDN's | PSNR over A's | corrected PSNR over A's | FLIP / "
        "OIDN's | MSE / A's, uncovered | corrected MSE / A's, uncovered |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for signal in SIGNALS:
        for name in document["sequences"].get(signal, ()):
            rows = _rows(document, signal, name)
            ours, oidn, a = (rows.get(name) for name in ("hybrid", "oidn", "A"))
            cells = [
                *(_difference(ours, peer, metric) for peer in (oidn, a) for metric in ("psnr", "psnr_corrected")),
                _ratio(ours, oidn, "frame", "flip"),
                *(_ratio(ours, a, "uncovered", metric) for metric in ("mse", "mse_corrected")),
            ]
            lines.append(f"| {name} | {signal} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _difference(ours: dict | None, peer: dict | None, metric: str) -> str:
    """Gain in dB over the whole frame."""
    values = [row and row["frame"].get(metric) for row in (ours, peer)]
    return "–" if None in values else f"{values[0] - values[1]:+.2f} dB"


def _ratio(ours: dict | None, peer: dict | None, region: str, metric: str) -> str:
    costs = [row and cost(metric, row[region].get(metric)) for row in (ours, peer)]
    return "–" if None in costs else f"{costs[0] / costs[1]:.2f}"


def _scenes(document: dict) -> list[str]:
    parts = []
    for signal in SIGNALS:
        for name, facts in document["sequences"].get(signal, {}).items():
            height, width = facts["size"]
            own = [write_number(metric, facts[f"reference_{metric}"]) for metric in ("psnr", "relmse")]
            parts += [
                f"### {name}, {signal}",
                f"{facts['frames']} frames of {width}×{height}, {100 * facts['uncovered_share']:.1f} % uncovered; the "
                f"references' own error: {own[0]} dB PSNR, relMSE {own[1]}.",
                f"![noisy, OIDN, default, hybrid, reference](../images/quality/{name}-{signal}.webp)",
                _table(_rows(document, signal, name)),
            ]
    return parts


def _table(rows: dict[str, dict]) -> str:
    heads = [METRICS[m].label for m in OF_FRAME] + [f"{METRICS[m].label}, uncovered" for m in OF_UNCOVERED]
    lines = [f"| | {' | '.join(heads)} | ghost length |", "|---" * (len(heads) + 2) + "|"]
    for method, row in rows.items():
        cells = [*_cells(row["frame"], OF_FRAME), *_cells(row["uncovered"], OF_UNCOVERED)]
        ghost = "–" if row["ghost_length"] is None else f"{row['ghost_length']:.0f}"
        lines.append(f"| {LABELS[method]} | {' | '.join(cells)} | {ghost} |")
    return "\n".join(lines)


def _cells(errors: dict[str, float | None], metrics: Sequence[str]) -> list[str]:
    return [write_number(metric, errors.get(metric)) for metric in metrics]


def _rows(document: dict, signal: str, sequence: str) -> dict[str, dict]:
    """method -> row, in the order of LABELS."""
    found = {r["method"]: r for r in document["rows"] if (r["signal"], r["sequence"]) == (signal, sequence)}
    return {method: found[method] for method in LABELS if method in found}


if __name__ == "__main__":
    harness.run(main, __doc__)
