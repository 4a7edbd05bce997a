"""The tables and the plot of `latency_720p.py`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rtdenoise.models import PRESETS

from .stages import STAGES

TOTAL = "total"
BASE = "oidn high"  # the method that all others are compared with
EMPTY = "–"


def table(document: dict, size: str) -> str:
    """One size. On a shared CPU only the ratios mean anything."""
    rows = [row for row in document["rows"] if row["size"] == size and row["method"].split()[0] in ("oidn", *PRESETS)]
    base = next((row[TOTAL]["median_ms"] for row in rows if row["method"] == BASE and TOTAL in row), None)
    W, H = rows[0]["pixels"]
    lines = [
        f"| {W}×{H}, {document['device']}, ms | {' | '.join(STAGES)} | total | against OIDN high | kernels, of copy | "
        "network, of product | peak MB |",
        "|---|" + "---|" * (len(STAGES) + 5),
    ]
    for row in rows:
        cells = _cells(row, base, document["measured_peaks"], 2 if document["device"] == "cuda" else 1)
        lines.append(f"| {row['method']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def short_table(document: dict, size: str, precisions: Sequence[str]) -> str:
    """Totals at one size, of methods with one of the `precisions`, and of OIDN."""
    rows = [row for row in document["rows"] if row["size"] == size]
    base, (W, H) = next(row[TOTAL]["median_ms"] for row in rows if row["method"] == BASE), rows[0]["pixels"]
    lines = [f"| {W}×{H}, ms | total | against OIDN high |", "|---|---|---|"]
    for row in rows:
        if row["method"].split()[-1] in precisions or row["method"].startswith("oidn"):
            total = _cells(row, base, document["measured_peaks"], 1)[len(STAGES) : len(STAGES) + 2]
            lines.append(f"| {row['method']} | {' | '.join(total)} |")
    return "\n".join(lines)


def _cells(row: dict, base: float | None, peaks: dict[str, float], places: int) -> list[str]:
    """Stages, total, ratio to `base`, rates of kernels and network relative to `peaks`, memory; milliseconds with so
    many decimal `places`."""
    stages, rates, memory = [EMPTY] * len(STAGES), [EMPTY, EMPTY], EMPTY
    if "reason" in row:
        return [*stages, row["reason"], EMPTY, *rates, memory]
    total = row[TOTAL]["median_ms"]
    ratio = EMPTY if base is None else f"{base / total:.2f}× as fast"
    if "stages" in row:
        times = {stage: row["stages"][stage]["median_ms"] for stage in STAGES}
        stages, memory = [f"{t:.{places}f}" for t in times.values()], f"{row['peak_mb']:.0f}"
    if "gb" in row:
        network, kernels = list(STAGES)[:2]
        rates = [f"{100 * row['gb'][kernels] / times[kernels] * 1000 / peaks['copy_gb_per_s']:.0f} %", EMPTY]
        if "int8" not in row["method"]:  # torch has no product of bytes to compare with
            product = peaks["bf16_gflop_per_s" if "bf16" in row["method"] else "fp32_gflop_per_s"]
            rates[1] = f"{100 * row['prediction_gflop'] / times[network] * 1000 / product:.0f} %"
    return [*stages, f"{total:.{places}f} ± {row[TOTAL]['iqr_ms']:.{places}f}", ratio, *rates, memory]


def scaling(rows: list[dict]) -> str:
    """Time and memory per megapixel at each size, of the methods that were timed at several; else an empty text."""
    found: dict[str, dict[str, str]] = {}
    for row in sorted(_timed(rows), key=lambda row: math.prod(row["pixels"])):
        megapixels = math.prod(row["pixels"]) / 1e6
        memory = f", {row['peak_mb'] / megapixels:.0f} MB" if row.get("peak_mb") else ""
        cell = f"{row[TOTAL]['median_ms'] / megapixels:.1f} ms{memory}"
        found.setdefault(row["method"], {})[row["size"]] = cell
    found = {method: cells for method, cells in found.items() if len(cells) > 1}
    sizes = list(dict.fromkeys(size for cells in found.values() for size in cells))
    lines = [f"| a megapixel | {' | '.join(sizes)} |", "|---|" + "---|" * len(sizes)]
    lines += [f"| {m} | {' | '.join(cells.get(size, EMPTY) for size in sizes)} |" for m, cells in found.items()]
    return "\n".join(lines) if found else ""


def plot(document: dict, path: Path) -> None:
    """Milliseconds per megapixel over the size of the picture, of the methods that were timed at several sizes, or of
    all if none was. Needs matplotlib."""
    from matplotlib.figure import Figure

    from rtdenoise.report.chart import plain_ticks

    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.add_subplot(
        xlabel="megapixels", ylabel="ms a megapixel", yscale="log", title=document["devices"]["torch"]
    )
    rows = _timed(document["rows"])
    found = {}
    for row in rows:
        found.setdefault(row["method"], []).append((math.prod(row["pixels"]) / 1e6, row[TOTAL]["median_ms"]))
    most = max(map(len, found.values()))
    for name, points in ((name, sorted(points)) for name, points in found.items() if len(points) == most):
        style = {"linestyle": "--"} if name.startswith("oidn") else {}
        axes.plot([m for m, _ in points], [ms / m for m, ms in points], marker="o", label=name, **style)
    plain_ticks(axes.yaxis, axes.get_ylim())
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=110)


def _timed(rows: list[dict]) -> list[dict]:
    return [row for row in rows if TOTAL in row]
