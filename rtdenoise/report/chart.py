"""The chart as a picture, for a README: error against time, one panel a metric."""

from __future__ import annotations

import io
import math
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullLocator

from .readings import METRICS, POOL

PANELS = ("psnr", "relmse", "flip")
COLOURS = {  # one a family
    "network": "#e8590c", "ablation": "#c9a08b", "oidn": "#1c7ed6", "filter": "#2f9e44", "accumulation": "#b8960c",
}  # fmt: skip
MOST_TICKS = 7
MARKERS = "os^Dvp*XP<>h"  # one a method of it


def chart(data: dict) -> bytes:
    """PNG of `page.payload`: all sequences together, at the fewest samples per pixel."""
    rows = _shown(data)
    title = f"{rows[0]['sequence']}, {rows[0]['spp']} spp; dotted: the Pareto front" if rows else "no denoiser measured"
    looks = _looks(rows, data["methods"])
    panels = [metric for metric in PANELS if any(row["errors"]["frame"].get(metric) is not None for row in rows)]
    panels = panels or [PANELS[0]]
    height = max(3.8, 0.18 * len(looks))  # of the legend
    figure = Figure(figsize=(3.6 * len(panels) + 2.2, height), dpi=110, layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for axis, metric in zip(axes, panels, strict=True):
        _panel(axis, metric, rows, looks, data["ours"])
    handles = [Line2D([], [], linestyle="", label=label, **look) for label, look in looks.items()]
    figure.legend(handles=handles, loc="outside right center", fontsize=8, frameon=False)
    figure.suptitle(title, fontsize=10, color="#555", parse_math=False)  # folders may have a $ in their names
    encoded = io.BytesIO()
    figure.savefig(encoded, format="png")
    return encoded.getvalue()


def _shown(data: dict) -> list[dict]:
    """The rows of the chart: denoisers on one sequence and device, at the fewest samples."""
    sequence = POOL if any(row["sequence"] == POOL for row in data["rows"]) else data["rows"][0]["sequence"]
    rows = [row for row in data["rows"] if row["sequence"] == sequence]
    fewest, device = min(row["spp"] for row in rows), rows[0]["device"]
    return [
        row for row in rows
        if (row["spp"], row["device"]) == (fewest, device) and data["methods"][row["method"]]["family"] != "input"
    ]  # fmt: skip


def _looks(rows: list[dict], methods: dict[str, dict]) -> dict[str, dict]:
    """label -> marker and colour."""
    markers, looks = {family: cycle(MARKERS) for family in COLOURS}, {}
    for row in rows:
        family = methods[row["method"]]["family"]
        looks[row["label"]] = {"marker": next(markers[family]), "color": COLOURS[family]}
    return looks


def _panel(axis: Axes, metric: str, rows: list[dict], looks: dict[str, dict], ours: str) -> None:
    points = {row["label"]: (row["ms"]["median"], row["errors"]["frame"].get(metric)) for row in rows}
    if on := sorted(points[row["label"]] for row in rows if metric in row["front"]["frame"]):
        axis.step(*zip(*on, strict=True), where="post", color="#555", linewidth=1, linestyle=":", zorder=1)
    for label, (x, y) in points.items():
        if y is not None:
            axis.plot(x, y, linestyle="", markersize=9 if label == ours else 6.5, **looks[label])
    info = METRICS[metric]
    axis.set_xscale("log")
    if not info.higher:
        axis.set_yscale("log")
    unit = f", {info.unit}" if info.unit else ""
    axis.set_title(f"{info.label}{unit}, better {'↑' if info.higher else '↓'}", fontsize=10)
    axis.set_xlabel("ms a frame", fontsize=9)
    axis.tick_params(labelsize=8)
    axis.grid(True, color="#eee")
    axis.set_axisbelow(True)
    axis.margins(0.1)
    plain_ticks(axis.xaxis, axis.get_xlim())
    if not info.higher:
        plain_ticks(axis.yaxis, axis.get_ylim())
    axis.spines[["top", "right"]].set_visible(False)


def plain_ticks(axis: Axis, limits: tuple[float, float]) -> None:
    """Ticks of a logarithmic axis as plain numbers, without minor ones."""
    ticks = tick_values(*limits)
    axis.set_ticks(ticks, [np.format_float_positional(tick, trim="-") for tick in ticks])
    axis.set_minor_locator(NullLocator())


def tick_values(low: float, high: float) -> list[float]:
    """Round numbers between two positive ones, at most MOST_TICKS, for a logarithmic axis."""
    if high < 5 * low:  # about as on a linear one
        found = MaxNLocator(MOST_TICKS - 1, steps=[1, 2, 5, 10]).tick_values(low, high)
        return [float(f"{v:.6g}") for v in found if low <= v <= high]
    decades = range(math.floor(math.log10(low)), math.floor(math.log10(high)) + 1)
    for every, factors in ((1, (1, 2, 5)), (1, (1, 3)), *((n, (1,)) for n in range(1, len(decades) + 1))):
        found = [float(f"{k}e{d}") for d in decades if d % every == 0 for k in factors]
        if len(found := [v for v in found if low <= v <= high]) <= MOST_TICKS:
            break
    return found
