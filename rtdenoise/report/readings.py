"""What the numbers say: who is ahead at which time, what it would take to be as good, and where others are better.

Rows are those of `evaluate.document.Document.results`. Errors of all metrics are compared as costs: positive, lower is
better, and such that noise falls with a power of the samples (a straight line in log-log).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..evaluate.document import Document

POOL = "all sequences"
PREFERRED = ("default", "paper")  # which network speaks for us, the first that was measured
HEADLINE = ("psnr", "ssim", "relmse", "flip", "tpsnr")  # metrics that wins and losses are counted in
OURS = ("network", "ablation")  # families


@dataclass(frozen=True)
class Metric:
    """How a metric is called and read."""

    label: str
    digits: int
    higher: bool = False  # is better
    unit: str = ""


METRICS = {
    "psnr": Metric("PSNR", 2, True, "dB"),
    "ssim": Metric("SSIM", 3, True),
    "relmse": Metric("relMSE", 4),
    "flip": Metric("FLIP", 3),
    "smape": Metric("SMAPE", 3),
    "l1": Metric("L1", 4),
    "mse": Metric("MSE", 5),
    "tpsnr": Metric("tPSNR", 2, True, "dB"),
    "temporal_relmae": Metric("temporal relMAE", 3),
}


def cost(metric: str, value: float | None) -> float | None:
    """The error as something positive of which less is better: decibels to mean squares, SSIM to 1 - SSIM. None where
    there is no such number."""
    if value is None or not math.isfinite(value):
        return None
    found = 10 ** (-value / 10) if METRICS[metric].unit == "dB" else 1 - value if metric == "ssim" else value
    return found if found > 0 else None


def label(row: dict) -> str:
    """A method with its precision, where that is not the usual one."""
    return row["method"] if row["precision"] == "fp32" else f"{row['method']} {row['precision']}"


def speaks_for_us(rows: Sequence[dict], methods: dict[str, dict]) -> str:
    """The name of the network that others are compared with; empty where none was measured."""
    found = {row["method"] for row in rows if methods[row["method"]]["family"] == "network"}
    return next((name for name in (*PREFERRED, *sorted(found)) if name in found), "")


def pooled(rows: Sequence[dict], sequences: dict[str, dict]) -> list[dict]:
    """One more sequence, `POOL`: mean error and geometric mean time of what was measured on all of them."""
    if len(sequences) < 2:
        return []
    groups = grouped(rows, "spp", "method", "precision", "device")
    return [_pool(group) for group in groups if len(group) == len(sequences)]


def sample_of(name: str, sequences: dict[str, dict]) -> float | None:
    """What one sample per pixel costs, in ms a frame; of `POOL` the geometric mean. None where one is not known."""
    known = [s["sample_ms"] for key, s in sequences.items() if name in (key, POOL)]
    return float(np.exp(np.mean(np.log(known)))) if known and all(known) else None


def front(points: Sequence[tuple[float, float | None]]) -> list[int]:
    """Indices of the Pareto front of (time, cost), by time: no other point is as fast and as good."""
    best, found = math.inf, []
    for i in sorted((i for i, p in enumerate(points) if p[1] is not None), key=lambda i: points[i]):
        if points[i][1] < best:
            best = points[i][1]
            found.append(i)
    return found


def mark_fronts(rows: Sequence[dict], sequences: dict[str, dict], methods: dict[str, dict]) -> None:
    """Give every row `front`, the metrics by region in which it is on the Pareto front of its input by denoising time,
    and `front_total`, that over all inputs of the sequence by time of rendering and denoising.

    The input itself takes part in the latter alone: it is what rendering without a denoiser gives.
    """
    for row in rows:
        row["front"], row["front_total"] = ({region: [] for region in row["errors"]} for _ in range(2))
    for group in grouped(rows, "sequence", "spp", "device"):
        denoised = [row for row in group if methods[row["method"]]["family"] != "input"]
        _mark(denoised, "front", [row["ms"]["median"] for row in denoised])
    for group in grouped(rows, "sequence", "device"):
        if sample := sample_of(group[0]["sequence"], sequences):
            _mark(group, "front_total", [total_ms(row, sample, methods) for row in group])


def total_ms(row: dict, sample: float, methods: dict[str, dict]) -> float:
    """Rendering and denoising a frame; the input needs no denoising."""
    return row["spp"] * sample + (0 if methods[row["method"]]["family"] == "input" else row["ms"]["median"])


def grouped(rows: Sequence[dict], *keys: str) -> list[list[dict]]:
    """The rows by what they have under these keys, in the order of their first."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(groups.values())


def _mark(group: list[dict], name: str, times: list[float]) -> None:
    for region in group[0]["errors"] if group else ():
        for metric in METRICS:
            points = [(t, cost(metric, row["errors"][region].get(metric))) for t, row in zip(times, group, strict=True)]
            for i in front(points):
                group[i][name][region].append(metric)


@dataclass(frozen=True)
class Curve:
    """One method on one sequence over samples per pixel, by one metric."""

    spp: tuple[int, ...]  # ascending
    cost: tuple[float, ...]
    ms: tuple[float, ...]  # of the denoiser

    def spp_for(self, wanted: float) -> tuple[float, bool] | None:
        """Samples at which the cost is `wanted`, log-log between what was measured; and whether that lies outside. None
        where more samples do not help, or one alone says nothing."""
        if len(self.spp) < 2:
            return None
        x, y, goal = np.log2(self.spp), np.log2(self.cost), math.log2(wanted)
        for i in range(len(x) - 1):
            if min(y[i : i + 2]) <= goal <= max(y[i : i + 2]) and y[i] != y[i + 1]:
                return float(2 ** (x[i] + (goal - y[i]) * (x[i + 1] - x[i]) / (y[i + 1] - y[i]))), False
        end = (0, 1) if wanted > max(self.cost) else (-1, -2)
        slope = (y[end[0]] - y[end[1]]) / (x[end[0]] - x[end[1]])
        if slope >= -0.05:  # it has levelled off: no number of samples gets there
            return None
        return float(2 ** (x[end[0]] + (goal - y[end[0]]) / slope)), True

    def cost_at(self, spp: float) -> float | None:
        """The cost at that many samples, log-log; None outside of what was measured."""
        if not self.spp[0] <= spp <= self.spp[-1]:
            return None
        return float(2 ** np.interp(math.log2(spp), np.log2(self.spp), np.log2(self.cost)))

    def total(self, sample: float) -> np.ndarray:
        """Milliseconds of rendering and denoising at each of `spp`."""
        return np.array(self.spp) * sample + np.array(self.ms)


def curve(rows: Sequence[dict], name: str, metric: str, region: str = "frame") -> Curve | None:
    """Of the rows of one sequence on one device, those of the method with this `label`."""
    found = sorted(
        (row["spp"], c, row["ms"]["median"])
        for row in rows
        if label(row) == name and (c := cost(metric, row["errors"][region].get(metric))) is not None
    )
    return Curve(*zip(*found, strict=True)) if found else None


def compare(ours: Curve, peer: Curve, sample: float | None) -> dict:
    """What it would take the peer to be as good as we are at our fewest samples, and how good it is in our time.

    equal_error   {"spp", "extrapolated", "ms": rendering and denoising, None where a sample's cost is not known}, or
                  None where it does not get there
    equal_time    {"spp": that the peer can afford in our time, "cost_ratio": peer's cost over ours}, or None where it
                  cannot afford one sample, its curve does not reach that far, or a sample's cost is not known
    area          the mean of log(peer's cost / our cost) over log time, between the shortest and the longest time that
                  both curves cover, as a factor: above 1 we are better over these budgets; with "from" and "to" in ms
    """
    found: dict[str, dict | None] = {"equal_error": None, "equal_time": None, "area": None}
    if reached := peer.spp_for(ours.cost[0]):
        spp, extrapolated = reached
        denoising = float(np.interp(math.log2(spp), np.log2(peer.spp), peer.ms))
        found["equal_error"] = {
            "spp": spp, "extrapolated": extrapolated, "ms": None if sample is None else spp * sample + denoising,
        }  # fmt: skip
    if sample is None:
        return found
    affordable = (ours.spp[0] * sample + ours.ms[0] - peer.ms[0]) / sample
    if affordable > 0 and (reachable := peer.cost_at(affordable)):
        found["equal_time"] = {"spp": affordable, "cost_ratio": reachable / ours.cost[0]}
    found["area"] = _area(ours, peer, sample)
    return found


def comparisons(rows: Sequence[dict], document: Document, us: str) -> list[dict]:
    """`compare` of `us` with every peer, a row a sequence, device, metric of HEADLINE and peer, errors of the frame."""
    found = []
    for group in grouped(rows, "sequence", "device"):
        sequence, device = group[0]["sequence"], group[0]["device"]
        sample = sample_of(sequence, document.sequences)
        peers = dict.fromkeys(label(r) for r in group if document.methods[r["method"]]["family"] not in OURS)
        for metric in HEADLINE:
            ours = curve(group, us, metric)
            for peer in peers:
                theirs = curve(group, peer, metric)
                if ours and theirs:
                    row = {"sequence": sequence, "device": device, "metric": metric, "peer": peer}
                    found.append(row | compare(ours, theirs, sample))
    return found


def losses_and_wins(rows: Sequence[dict], methods: dict[str, dict], us: str) -> tuple[list[dict], list[dict]]:
    """Where the best peer is better than `us`, and where it is not: a row a sequence, spp, region and metric of
    HEADLINE."""
    lost, won = [], []
    for group in grouped(rows, "sequence", "spp", "device"):
        own = next((r for r in group if label(r) == us), None)
        peers = [r for r in group if methods[r["method"]]["family"] not in (*OURS, "input")]
        if own is None:
            continue
        for region in ("frame", "uncovered"):
            for metric in HEADLINE:
                mine = cost(metric, own["errors"][region].get(metric))
                theirs = [(c, r) for r in peers if (c := cost(metric, r["errors"][region].get(metric))) is not None]
                if mine is None or not theirs:
                    continue
                best, peer = min(theirs, key=lambda pair: pair[0])
                (lost if best < mine else won).append({
                    **{key: own[key] for key in ("sequence", "spp", "device")}, "region": region, "metric": metric,
                    "peer": label(peer), "peer_value": peer["errors"][region].get(metric),
                    "our_value": own["errors"][region].get(metric),
                    "time_ratio": peer["ms"]["median"] / own["ms"]["median"],
                })  # fmt: skip
    return lost, won


def _area(ours: Curve, peer: Curve, sample: float) -> dict | None:
    (a, b), (t, u) = (ours.total(sample), peer.total(sample)), (np.log2(ours.cost), np.log2(peer.cost))
    start, end = max(a.min(), b.min()), min(a.max(), b.max())
    if not start < end:
        return None
    times = np.linspace(math.log2(start), math.log2(end), 65)
    difference = np.interp(times, np.log2(b), u) - np.interp(times, np.log2(a), t)
    return {"factor": float(2 ** difference.mean()), "from": float(start), "to": float(end)}


def _pool(group: list[dict]) -> dict:
    def mean(values: list[float | None]) -> float | None:
        known = [v for v in values if v is not None]
        return float(np.mean(known)) if known else None

    regions = group[0]["errors"]
    return {
        **{key: group[0][key] for key in ("spp", "method", "precision", "device", "run")},
        "sequence": POOL,
        "ms": {"median": float(np.exp(np.mean(np.log([r["ms"]["median"] for r in group])))), "iqr": None, "steps": 0},
        "errors": {
            region: {metric: mean([r["errors"][region].get(metric) for r in group]) for metric in regions[region]}
            for region in regions
        },
        "ghost_length": mean([r["ghost_length"] for r in group]),
        "frames": [],
    }  # fmt: skip
