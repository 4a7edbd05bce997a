"""What is it worth to wait for a few frames more?

python bench/lookahead.py SEQ ...    # sequences with references that no network was trained on

Measures networks that look 1 to 8 frames ahead (`denoise --lookahead`) at 1 sample, both signals. Sequences are told
apart by the folder that they lie in. Then the time of a step. Writes bench/results/lookahead.json, tables of
docs/notes/lookahead.md and strips in docs/images/lookahead. An interrupted run continues. Sets of which no
sequence is named stay as they were. With --keep-times errors alone are measured, and times stay those of the CPU that
they were measured on.
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

from bench.latency.methods import partly_in_bytes, settled, stepping, synthetic_frame
from rtdenoise.baselines import Oidn
from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
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
IN_WINDOWS = ("offline-without-oidn", "offline")  # of large pictures alone, as these take long
REAL_TIME = ("default", "hybrid-fast", "hybrid", "hybrid-large")  # likewise, in bytes
METRICS = ("psnr_corrected", "flip", "tpsnr_corrected")
SHOWN = {"OIDN": "oidn", "hybrid": "hybrid", "six ahead": "hybrid-ahead6"}
LARGE = "standard720"
DRAWN = (LARGE, "color"), ("street", "staircase2")  # the sequences that are drawn
SETS = {LARGE: "windows of 1280×720", "standard": "small pictures"}
TIMED, AHEAD = ("hybrid",), (0, 1, 2, 4, 6, 8)


def main(sequences: tyro.conf.Positional[tuple[str, ...]], keep_times: bool = False) -> None:
    """Measure.

    Args:
        sequences: Folders of EXR files with references.
        keep_times: The times in the JSON file stay.
    """
    sets, rows = {}, []
    for sequence in sequences:
        sets.setdefault(Path(sequence).resolve().parent.name, []).append(sequence)
    for where, members in sets.items():
        for signal in SIGNALS:
            at = {"metrics": METRICS, "signal": signal}
            plain, in_bytes = methods_of(where)
            run(members, OUT / where / signal, EvaluateOptions((REFERENCE, *plain), **at))
            document = run(members, OUT / where / signal, EvaluateOptions(in_bytes, ("int8",), **at))
            for name in document.sequences if (where, signal) == DRAWN[0] else ():
                if name in DRAWN[1]:
                    facts = document.sequences[name]
                    strips.draw(OUT / where / signal, name, facts, SHOWN, PICTURES / f"{name}.webp")
            for row in (row for row in document.results if row["spp"] == 1):
                errors = {region: {m: row["errors"][region][m] for m in METRICS} for region in ("frame", "uncovered")}
                about = {"set": where, "signal": signal, "sequence": row["sequence"], "method": label(row)}
                rows.append(about | errors)
    others, sets_of = harness.sets_kept(RESULT, sets)
    times = harness.times_kept(RESULT) if keep_times else {"times": [times_of(quickest())]}
    content = {"rows": rows + others, "sets_of": sets_of, **times}
    harness.publish(RESULT, content, digits=4, pages=PAGES, tables=tables)


def methods_of(where: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is measured on a set in float32, and in bytes."""
    return ((*METHODS, *IN_WINDOWS), (*REAL_TIME, *IN_BYTES)) if where == LARGE else (METHODS, IN_BYTES)


def quickest() -> str:
    """The precision of what is not in bytes that takes the least time on this CPU."""
    return "bf16" if resolve("auto", "cpu") == torch.bfloat16 else "fp32"


@torch.inference_mode()
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
                steps[f"{shown} {count}"] = stepping(network, frame, history, count)
    timings = harness.measure(steps, calls=7, warmup=2)
    return {"precision": precision, **{name: timing.median_ms for name, timing in timings.items()}}


# --- tables -----------------------------------------------------------------------------------------------------------


def tables(document: dict) -> dict[str, str]:
    """Sections `lookahead`, each method over OIDN, and `lookahead-times`."""
    rows = {(r["set"], r["method"], r["sequence"], r["signal"]): r for r in document["rows"]}
    return {"lookahead": _methods(rows), "lookahead-times": _times(document["times"])}


def pairs_of(rows: dict, where: str | int, method: str, signal: str = "") -> list[tuple[dict, dict]]:
    """Rows of a method, each with OIDN's. Keys: set or samples, method, sequence, signal."""
    found = [key for key in rows if key[:2] == (where, method) and signal in key[3]]
    return [(rows[key], rows[key[0], REFERENCE, *key[2:]]) for key in found]


def leads(pairs: list[tuple[dict, dict]], region: str = "frame", metric: str = "psnr_corrected") -> list[float]:
    """How much more a method has than OIDN, of each pair that both have."""
    each = [(a[region][metric], b[region][metric]) for a, b in pairs]
    return [ours - theirs for ours, theirs in each if None not in (ours, theirs)]


def _methods(rows: dict) -> str:
    lines = [
        "| | corrected PSNR, beauty, indirect | least | uncovered | least | FLIP | corrected tPSNR |",
        "|---" * 7 + "|",
    ]
    for where, shown in SETS.items():
        lines.append(f"| *{shown}* | | | | | | |")
        plain, in_bytes = methods_of(where)
        for method in (*plain, *(f"{name} int8" for name in in_bytes)):
            pairs = pairs_of(rows, where, method)
            each = [np.mean(leads(pairs_of(rows, where, method, signal))) for signal in SIGNALS]
            frame, uncovered = leads(pairs), leads(pairs, "uncovered")
            flip = np.mean([a["frame"]["flip"] / b["frame"]["flip"] for a, b in pairs])
            steady = np.mean(leads(pairs, metric="tpsnr_corrected"))
            lines.append(
                f"| `{method}` | {each[0]:+.2f}, {each[1]:+.2f} dB | {min(frame):+.2f} | {np.mean(uncovered):+.2f} | "
                f"{min(uncovered):+.2f} | {flip:.2f}× | {steady:+.2f} |"
            )
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
