"""What is it worth to wait for a few frames more, and how good is `hybrid` at more samples a pixel?

python bench/lookahead.py SEQ ...    # sequences with references that no network was trained on

Measures networks that look 1, 2 and 4 frames ahead (`denoise --lookahead`) at 1 sample, both signals. Sequences are
told apart by the folder that they lie in. Where SEQ/spp4, SEQ/spp8 ... hold the same frames at more samples, also
`hybrid`, `hybrid-many` and `hybrid-large-many`. Then the time of a step. Writes bench/results/lookahead.json, the
tables of docs/notes/lookahead.md and strips in docs/images/lookahead. An interrupted run continues.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness
from bench.harness import strips

# isort: split
import numpy as np
import torch
import tyro

from bench.latency.methods import partly_in_bytes, settled, synthetic_frame
from rtdenoise.baselines import Oidn
from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
from rtdenoise.frame import Known
from rtdenoise.models import load
from rtdenoise.models.inference import resolve
from rtdenoise.report.readings import label

RESULT, PAGES = RESULTS / "lookahead.json", (DOCS / "notes" / "lookahead.md",)
OUT, PICTURES = ROOT / "out" / "lookahead", DOCS / "images" / "lookahead"
SIGNALS = ("color", "indirect")
REFERENCE = "oidn"
METHODS = ("default", "default-ahead6", "hybrid-fast", "hybrid-fast-ahead6", "hybrid", "hybrid-ahead1", "hybrid-ahead2",
           "hybrid-ahead4", "hybrid-ahead6", "hybrid-ahead8", "hybrid-large", "hybrid-large-ahead6")  # fmt: skip
IN_BYTES = ("hybrid-fast-ahead6", "hybrid-ahead2", "hybrid-ahead6", "hybrid-large-ahead6")
MANY = ("hybrid", "hybrid-many", "hybrid-many-ahead2", "hybrid-large-many", "hybrid-large-many-ahead2")
MANY_IN_BYTES = ("hybrid-many",)
METRICS = ("psnr_corrected", "flip", "tpsnr_corrected")
SHOWN = {"OIDN": "oidn", "hybrid": "hybrid", "six ahead": "hybrid-ahead6"}
DRAWN = ("standard720", "color"), ("street", "staircase2")  # the sequences that are drawn
SETS = {"standard720": "windows of 1280×720", "standard": "small pictures"}
TIMED, AHEAD = ("hybrid-fast", "hybrid"), (0, 1, 2, 4, 6, 8)


def main(sequences: tyro.conf.Positional[tuple[str, ...]]) -> None:
    """Measure.

    Args:
        sequences: Folders of EXR files with references.
    """
    sets, rows = {}, []
    for sequence in sequences:
        sets.setdefault(Path(sequence).resolve().parent.name, []).append(sequence)
    for where, members in sets.items():
        counts = sorted({int(p.name[3:]) for s in members for p in Path(s).glob("spp*")})
        for signal in SIGNALS:
            at = {"metrics": METRICS, "signal": signal}
            run(members, OUT / where / signal, EvaluateOptions((REFERENCE, *METHODS), **at))
            document = run(members, OUT / where / signal, EvaluateOptions(IN_BYTES, ("int8",), **at))
            if counts:
                run(members, OUT / where / signal, EvaluateOptions((REFERENCE, *MANY), spp=tuple(counts), **at))
                options = EvaluateOptions(MANY_IN_BYTES, ("int8",), spp=tuple(counts), **at)
                document = run(members, OUT / where / signal, options)
            for name in document.sequences if (where, signal) == DRAWN[0] else ():
                if name in DRAWN[1]:
                    facts = document.sequences[name]
                    strips.draw(OUT / where / signal, name, facts, SHOWN, PICTURES / f"{name}.webp")
            for row in document.results:
                errors = {region: {m: row["errors"][region][m] for m in METRICS} for region in ("frame", "uncovered")}
                rows.append({"set": where, "signal": signal, "sequence": row["sequence"], "method": label(row),
                             "spp": row["spp"], **errors})  # fmt: skip
    precisions = ("bf16", "fp32") if resolve("auto", "cpu") == torch.bfloat16 else ("fp32",)
    with torch.inference_mode():
        times = [times_of(precision) for precision in precisions]
    harness.publish(RESULT, {"rows": rows, "times": times}, digits=4, pages=PAGES, tables=tables)


def times_of(precision: str) -> dict:
    """Milliseconds of a step with history at 720p, by network and frames ahead; with int8 what is not in bytes has this
    precision."""
    frame = synthetic_frame(720, 1280)
    steps = {REFERENCE: partial(Oidn().step, frame)}
    for name in TIMED:
        models = {name: load(name, precision=precision), f"{name} int8": partly_in_bytes(name, precision)}
        for shown, network in models.items():
            history = settled(network, frame)
            for count in AHEAD:
                known = Known(ahead=(frame,) * count)
                steps[f"{shown} {count}"] = partial(network.step, frame, history, known)
    timings = harness.measure(steps, calls=7, warmup=2)
    return {"precision": precision, **{name: timing.median_ms for name, timing in timings.items()}}


# --- tables -----------------------------------------------------------------------------------------------------------


def tables(document: dict) -> dict[str, str]:
    """Sections `lookahead`, each method over OIDN; `lookahead-many`, by samples; `lookahead-times`."""
    rows = {(r["set"], r["spp"], r["method"], r["sequence"], r["signal"]): r for r in document["rows"]}
    return {"lookahead": _methods(rows), "lookahead-many": _many(rows), "lookahead-times": _times(document["times"])}


def _pairs(rows: dict, where: str, spp: int, method: str, signal: str = "") -> list[tuple[dict, dict]]:
    """Rows of a method, each with OIDN's."""
    found = [key for key in rows if key[:3] == (where, spp, method) and signal in key[4]]
    return [(rows[key], rows[(*key[:2], REFERENCE, *key[3:])]) for key in found]


def _leads(pairs: list[tuple[dict, dict]], region: str = "frame", metric: str = "psnr_corrected") -> list[float]:
    each = [(a[region][metric], b[region][metric]) for a, b in pairs]
    return [ours - theirs for ours, theirs in each if None not in (ours, theirs)]


def _methods(rows: dict) -> str:
    lines = [
        "| | corrected PSNR, beauty, indirect | least | uncovered | least | FLIP | corrected tPSNR |",
        "|---" * 7 + "|",
    ]
    for where, shown in SETS.items():
        lines.append(f"| *{shown}* | | | | | | |")
        for method in (*METHODS, *(f"{name} int8" for name in IN_BYTES)):
            pairs = _pairs(rows, where, 1, method)
            each = [np.mean(_leads(_pairs(rows, where, 1, method, signal))) for signal in SIGNALS]
            frame, uncovered = _leads(pairs), _leads(pairs, "uncovered")
            flip = np.mean([a["frame"]["flip"] / b["frame"]["flip"] for a, b in pairs])
            steady = np.mean(_leads(pairs, metric="tpsnr_corrected"))
            lines.append(
                f"| `{method}` | {each[0]:+.2f}, {each[1]:+.2f} dB | {min(frame):+.2f} | {np.mean(uncovered):+.2f} | "
                f"{min(uncovered):+.2f} | {flip:.2f}× | {steady:+.2f} |"
            )
    return "\n".join(lines)


def _many(rows: dict) -> str:
    counts = sorted({spp for _, spp, *_ in rows} - {1})
    lines = [
        f"| | {' | '.join(f'{spp} spp' for spp in counts)} | {' | '.join(f'uncovered, {spp} spp' for spp in counts)} |",
        "|---" * (2 * len(counts) + 1) + "|",
    ]
    for signal, shown in zip(SIGNALS, ("beauty", "indirect light"), strict=True):
        lines.append(f"| *{shown}* |{' |' * 2 * len(counts)}")
        for method in (*MANY, *(f"{name} int8" for name in MANY_IN_BYTES)):
            cells = []
            for region in ("frame", "uncovered"):
                for spp in counts:
                    leads = _leads(_pairs(rows, "standard720", spp, method, signal), region)
                    cells.append(f"{np.mean(leads):+.2f}, {min(leads):+.2f}")
            lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _times(times: list[dict]) -> str:
    names = [f"{name}{suffix}" for name in TIMED for suffix in ("", " int8")]
    columns = [f"`{name}`, {row['precision']}" for row in times for name in names]
    lines = [f"| frames ahead | {' | '.join(columns)} |"]
    lines.append("|---" * (len(names) * len(times) + 1) + "|")
    for count in AHEAD:
        cells = [f"{row[f'{name} {count}'] / row[REFERENCE]:.2f}×" for row in times for name in names]
        lines.append(f"| {count} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    harness.run(main, __doc__)
