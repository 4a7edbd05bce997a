"""How good is the picture in windows of 1280×720, and how many samples does OIDN need for as good a one?

python bench/large.py SEQ ...    # sequences with references that no network was trained on (docs/results/large.md)

SEQ/spp4, SEQ/spp8 ... hold the same frames at more samples. Both signals are measured at 1 sample, and beauty at more:
OIDN, `many` and the combiner. Writes bench/results/large.json, the tables of docs/results/large.md and strips of beauty
in docs/images/large. An interrupted run continues. FovVideoVDP needs `pip install pyfvvdp`.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness
from bench.harness import strips

# isort: split
import numpy as np
import tyro

from rtdenoise.evaluate.options import EvaluateOptions
from rtdenoise.evaluate.run import run
from rtdenoise.report.readings import label

RESULT, PAGES = RESULTS / "large.json", (DOCS / "results" / "large.md",)
OUT, PICTURES = ROOT / "out" / "large", DOCS / "images" / "large"
SIGNALS = ("color", "indirect")
SPP = (4, 8, 16, 64)  # beside 1
OURS = ("default-spatial", "hybrid-fast-spatial", "hybrid-spatial", "hybrid-large-spatial", "default", "hybrid-fast",
        "hybrid", "hybrid-large", "hybrid-large-ahead2", "offline-without-oidn", "offline")  # fmt: skip
IN_BYTES = ("default", "hybrid-fast", "hybrid", "hybrid-ahead2")  # measured in int8, too
SHOWN_OURS = *OURS[:-2], *(f"{name} int8" for name in IN_BYTES), *OURS[-2:]
MANY = ("many", "hybrid-many", "hybrid-large-many", "oidn+combiner")
METRICS = ("psnr_corrected", "ssim", "relmse", "flip", "tpsnr_corrected")
SEEN = "fovvideovdp"  # over the frame at 1 sample; needs pyfvvdp
FRAMES = (1, 4, 9, 15)  # numbers of frames that are shown by themselves
SHOWN = {"OIDN": "oidn", "default": "default", "hybrid": "hybrid", "offline": "offline"}
REFERENCE = "oidn"


def main(sequences: tyro.conf.Positional[tuple[str, ...]]) -> None:
    """Measure.

    Args:
        sequences: Folders of EXR files with references.
    """
    rows = []
    for signal in SIGNALS:
        counts, at = SPP if signal == "color" else (), {"metrics": (*METRICS, SEEN), "signal": signal}
        run(sequences, OUT / signal, EvaluateOptions((REFERENCE, "oidn-prefiltered", *OURS), **at))
        document = run(sequences, OUT / signal, EvaluateOptions(IN_BYTES, ("int8",), **at))
        if counts:
            more = EvaluateOptions((REFERENCE, *MANY), spp=counts, metrics=METRICS, signal=signal)
            document = run(sequences, OUT / signal, more)
            for name, facts in document.sequences.items():
                strips.draw(OUT / signal, name, facts, SHOWN, PICTURES / f"{name}.webp")
        for row in (row for row in document.results if row["spp"] in (1, *counts)):
            rows.append({
                "signal": signal, "sequence": row["sequence"], "method": label(row), "spp": row["spp"],
                "ms": row["ms"]["median"],
                **{region: {m: row["errors"][region][m] for m in METRICS} for region in ("frame", "uncovered")},
                **({SEEN: row["errors"]["frame"][SEEN]} if row["spp"] == 1 else {}),
                "frames": {str(f["number"]): f["frame"]["psnr_corrected"] for f in row["frames"]},
            })  # fmt: skip
    harness.publish(RESULT, {"rows": rows}, digits=5, pages=PAGES, tables=tables)


# --- tables -----------------------------------------------------------------------------------------------------------


def tables(document: dict) -> dict[str, str]:
    """Sections `large`, every method at 1 sample over OIDN; `large-frames`, the lead by frame; `large-sequences`, by
    sequence; `large-samples`, OIDN at more samples, and ours over it."""
    at_1 = _by(document["rows"], 1)
    return {
        "large": _over_oidn(at_1), "large-frames": _by_frame(at_1), "large-sequences": _by_sequence(at_1),
        "large-samples": _by_samples(document["rows"]),
    }  # fmt: skip


def _by(rows: list[dict], spp: int) -> dict[str, dict[tuple[str, str], dict]]:
    """Method -> (sequence, signal) -> row."""
    found = {}
    for row in rows:
        if row["spp"] == spp:
            found.setdefault(row["method"], {})[row["sequence"], row["signal"]] = row
    return found


def _leads(rows: dict, base: dict, metric: str = "psnr_corrected", region: str = "frame", signal: str = "") -> list:
    """What each row has more than that of `base`."""
    pairs = [(rows[key][region][metric], base[key][region][metric]) for key in rows if signal in key[1]]
    return [ours - theirs for ours, theirs in pairs if None not in (ours, theirs)]


def _ratio(rows: dict, base: dict, read) -> float:
    """Geometric mean of what `read` takes from each row, over that of `base`."""
    return float(np.exp(np.mean([np.log(read(rows[key]) / read(base[key])) for key in rows])))


def _over_oidn(at_1: dict) -> str:
    lines = [
        "| | corrected PSNR, beauty, indirect | least | uncovered | least | SSIM | relMSE | FLIP | corrected tPSNR "
        "| FovVideoVDP | time |",
        "|---" * 11 + "|",
    ]
    base = at_1[REFERENCE]
    for method in ("oidn-prefiltered", *SHOWN_OURS):
        rows = at_1[method]
        each = [np.mean(_leads(rows, base, signal=signal)) for signal in SIGNALS]
        uncovered = _leads(rows, base, region="uncovered")
        cells = [
            f"{each[0]:+.2f}, {each[1]:+.2f} dB", f"{min(_leads(rows, base)):+.2f}", f"{np.mean(uncovered):+.2f}",
            f"{min(uncovered):+.2f}", f"{np.mean(_leads(rows, base, 'ssim')):+.3f}",
            *(f"{_ratio(rows, base, lambda row, m=m: row['frame'][m]):.2f}×" for m in ("relmse", "flip")),
            f"{np.mean(_leads(rows, base, 'tpsnr_corrected')):+.2f}",
            f"{np.mean([row[SEEN] - base[key][SEEN] for key, row in rows.items()]):+.3f}",
            f"{_ratio(rows, base, lambda row: row['ms']):.2f}×",
        ]  # fmt: skip
        lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _by_frame(at_1: dict) -> str:
    lines = [f"| | {' | '.join(f'frame {number}' for number in FRAMES)} |", "|---" * (len(FRAMES) + 1) + "|"]
    for method in SHOWN_OURS:
        cells = []
        for number in map(str, FRAMES):
            pairs = [
                (row["frames"][number], at_1[REFERENCE][key]["frames"][number]) for key, row in at_1[method].items()
            ]
            cells.append(f"{np.mean([a - b for a, b in pairs if None not in (a, b)]):+.2f}")
        lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _by_sequence(at_1: dict) -> str:
    keys = list(at_1[REFERENCE])
    lines = [f"| | {' | '.join(f'{name}, {signal}' for name, signal in keys)} |", "|---" * (len(keys) + 1) + "|"]
    for method in ("oidn-prefiltered", *SHOWN_OURS):
        pairs = [(at_1[method][key], at_1[REFERENCE][key]) for key in keys]
        cells = [f"{a['frame']['psnr_corrected'] - b['frame']['psnr_corrected']:+.2f}" for a, b in pairs]
        lines.append(f"| `{method}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def _by_samples(rows: list[dict]) -> str:
    """Lead over OIDN at 1 sample, and over OIDN at as many; then of corrected tPSNR."""
    columns = [f"{spp} spp" for spp in SPP]
    lines = [f"| | {' | '.join([*columns, *(f'tPSNR, {column}' for column in columns)])} |"]
    lines.append("|---" * (2 * len(SPP) + 1) + "|")
    once, levels = _by(rows, 1)[REFERENCE], {spp: _by(rows, spp) for spp in SPP}
    for method in (REFERENCE, *MANY):
        bases = {spp: once if method == REFERENCE else levels[spp][REFERENCE] for spp in SPP}
        leads = {spp: _leads(levels[spp][method], base) for spp, base in bases.items()}
        cells = [f"{np.mean(lead):+.2f}, {min(lead):+.2f}" for lead in leads.values()]
        for spp, base in bases.items():
            cells.append(f"{np.mean(_leads(levels[spp][method], base, 'tpsnr_corrected')):+.2f}")
        name = "OIDN, over itself at 1 spp" if method == REFERENCE else f"`{method}`, over OIDN at as many"
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    harness.run(main, __doc__)
