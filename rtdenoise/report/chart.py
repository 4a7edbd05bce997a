"""The chart as a picture, for a README: error against time, one panel a metric."""

from __future__ import annotations

import io
from itertools import cycle

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .readings import METRICS, POOL

PANELS = ("psnr", "relmse", "flip")
NETWORKS = "#e8590c", "#ffa94d", "#c2255c", "#f783ac", "#862e9c", "#cc5de8", "#7f4f24", "#b08968"  # two shades of each
FAMILIES = {  # marker, colours of its methods in turn
    "network": ("o", NETWORKS),
    "ablation": ("o", NETWORKS),
    "oidn": ("s", ("#1864ab", "#4dabf7", "#74c0fc", "#7048e8", "#15aabf", "#0b7285")),
    "filter": ("^", ("#8ce99a", "#2b8a3e")),
    "accumulation": ("D", ("#ffd43b", "#997404")),
}


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
    handles = [axes[0].plot([], [], linestyle="", label=label, **look)[0] for label, look in looks.items()]
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
    """label -> marker and colours."""
    colours, looks = {family: cycle(of_family) for family, (_, of_family) in FAMILIES.items()}, {}
    for row in rows:
        family = methods[row["method"]]["family"]
        colour = next(colours[family])
        face = "white" if family == "ablation" else colour
        looks[row["label"]] = {"marker": FAMILIES[family][0], "color": colour, "markerfacecolor": face}
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
    axis.tick_params(labelsize=8, which="both")
    axis.grid(True, which="both", color="#eee")
    axis.set_axisbelow(True)
    axis.margins(0.1)
    axis.spines[["top", "right"]].set_visible(False)
