"""Readings of the numbers: who is ahead at which time, and where others are better.

Rows are those of `evaluate.document.Document.results`. Errors of all metrics are compared as costs: positive, lower is
better, and such that noise falls with a power of the samples (a straight line in log-log).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from ..evaluate.document import by_precision

POOL = "all sequences"
PREFERRED = ("hybrid", "default", "paper")  # the first that was measured is compared with the peers
HEADLINE = ("psnr", "ssim", "relmse", "flip", "tpsnr")  # metrics and
REGIONS = ("frame", "uncovered")  # regions in which wins and losses are counted
OURS = ("network", "ablation")  # families


@dataclass(frozen=True)
class Metric:
    """Name, digits and direction of a metric."""

    label: str
    digits: int
    higher: bool = False  # is better
    unit: str = ""


METRICS = {
    "psnr": Metric("PSNR", 2, True, "dB"),
    "psnr_corrected": Metric("corrected PSNR", 2, True, "dB"),
    "ssim": Metric("SSIM", 3, True),
    "relmse": Metric("relMSE", 4),
    "flip": Metric("FLIP", 3),
    "smape": Metric("SMAPE", 3),
    "l1": Metric("L1", 4),
    "mse": Metric("MSE", 5),
    "mse_corrected": Metric("corrected MSE", 5),
    "tpsnr": Metric("tPSNR", 2, True, "dB"),
    "tpsnr_corrected": Metric("corrected tPSNR", 2, True, "dB"),
    "tmse_corrected": Metric("corrected temporal MSE", 5),
    "temporal_relmae": Metric("temporal relMAE", 3),
    "fovvideovdp": Metric("FovVideoVDP", 2, True, "JOD"),
}

BEST = {"ssim": 1.0, "fovvideovdp": 10.0}  # highest value of qualities that are not in decibels


def cost(metric: str, value: float | None) -> float | None:
    """The error as a positive number, lower is better: decibels become mean squares, other qualities their distance
    from the best value. None where the value is missing or the cost is not positive."""
    if value is None or not math.isfinite(value):
        return None
    found = 10 ** (-value / 10) if METRICS[metric].unit == "dB" else BEST[metric] - value if metric in BEST else value
    return found if found > 0 else None


def label(row: dict) -> str:
    """The method, with its precision unless that is fp32."""
    return row["method"] if row["precision"] == "fp32" else f"{row['method']} {row['precision']}"


def speaks_for_us(rows: Sequence[dict], methods: dict[str, dict]) -> str:
    """The `label` of the network that the peers are compared with: the first of `PREFERRED`, or else that of the
    highest PSNR; empty if none was measured."""
    networks = [row for row in rows if methods[row["method"]]["family"] == "network"]
    found = {row["method"]: label(row) for row in sorted(networks, key=by_precision, reverse=True)}  # fp32 if there

    def rank(name: str) -> tuple[float, str]:
        values = [row["errors"]["frame"].get("psnr") or 0.0 for row in networks if row["method"] == name]
        return -sum(values) / len(values), name

    return next((found[name] for name in (*PREFERRED, *sorted(found, key=rank)) if name in found), "")


def pooled(rows: Sequence[dict], sequences: dict[str, dict]) -> list[dict]:
    """Rows of one more sequence, `POOL`: mean error and geometric mean time of methods measured on all sequences."""
    if len(sequences) < 2:
        return []
    groups = grouped(rows, "spp", "method", "precision", "device")
    return [_pool(group) for group in groups if len(group) == len(sequences)]


def sample_of(name: str, sequences: dict[str, dict]) -> float | None:
    """Render time of one sample per pixel, in ms a frame; the geometric mean for `POOL`. None if one is not known."""
    known = [s["sample_ms"] for key, s in sequences.items() if name in (key, POOL)]
    return float(np.exp(np.mean(np.log(known)))) if known and all(known) else None


def front(points: Sequence[tuple[float, float | None]]) -> list[int]:
    """Indices of the Pareto front of (time, cost), by time: no other point is as fast and as good as these."""
    best, found = math.inf, []
    for i in sorted((i for i, p in enumerate(points) if p[1] is not None), key=lambda i: points[i]):
        if points[i][1] < best:
            best = points[i][1]
            found.append(i)
    return found


def mark_fronts(rows: Sequence[dict], sequences: dict[str, dict], methods: dict[str, dict]) -> None:
    """Give every row two dictionaries region -> metrics in which it is on a Pareto front: `front` among the rows of its
    input, by denoising time; `front_total` among all inputs of its sequence, by rendering and denoising time.

    The noisy input takes part in `front_total` alone: it is the result of rendering without a denoiser.
    """
    for row in rows:
        row["front"], row["front_total"] = ({region: [] for region in row["errors"]} for _ in range(2))
    for group in grouped(rows, "sequence", "spp", "device"):
        denoised = [row for row in group if methods[row["method"]]["family"] != "input"]
        _mark(denoised, "front", [row["ms"]["median"] for row in denoised])
    for group in grouped(rows, "sequence", "device"):
        if sample := sample_of(group[0]["sequence"], sequences):
            _mark(group, "front_total", [row["spp"] * sample + denoising_ms(row, methods) for row in group])


def denoising_ms(row: dict, methods: dict[str, dict]) -> float:
    """Median time of a step; the input needs none."""
    return 0.0 if methods[row["method"]]["family"] == "input" else row["ms"]["median"]


def grouped(rows: Sequence[dict], *keys: str) -> list[list[dict]]:
    """Rows with equal values of these keys together, in the order of their first."""
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(groups.values())


def _mark(group: list[dict], name: str, times: list[float]) -> None:
    for region in group[0]["errors"] if group else ():
        for metric in METRICS:
            points = [(t, _cost_of(row, region, metric)) for t, row in zip(times, group, strict=True)]
            for i in front(points):
                group[i][name][region].append(metric)


def losses_and_wins(rows: Sequence[dict], methods: dict[str, dict], us: str) -> tuple[list[dict], list[dict]]:
    """Where the best peer beats `us`, and where it does not: a row a sequence, spp, region and metric of HEADLINE."""
    lost, won = [], []
    for group in grouped(rows, "sequence", "spp", "device"):
        own = next((r for r in group if label(r) == us), None)
        peers = [r for r in group if methods[r["method"]]["family"] not in (*OURS, "input")]
        for region, metric in product(REGIONS, HEADLINE) if own else ():
            mine = _cost_of(own, region, metric)
            theirs = [(c, r) for r in peers if (c := _cost_of(r, region, metric)) is not None]
            if mine is not None and theirs:
                best, peer = min(theirs, key=lambda pair: pair[0])
                (lost if best < mine else won).append(_duel(own, peer, region, metric))
    return lost, won


def _cost_of(row: dict, region: str, metric: str) -> float | None:
    return cost(metric, row["errors"].get(region, {}).get(metric))


def _duel(own: dict, peer: dict, region: str, metric: str) -> dict:
    return {
        **{key: own[key] for key in ("sequence", "spp", "device")}, "region": region, "metric": metric,
        "peer": label(peer), "peer_value": peer["errors"][region].get(metric),
        "our_value": own["errors"][region].get(metric),
        "time_ratio": peer["ms"]["median"] / own["ms"]["median"],
    }  # fmt: skip


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
