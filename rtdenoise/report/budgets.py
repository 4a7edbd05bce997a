"""Equal error and equal time: how many samples, or how much time, another method needs for the same error.

Errors are compared as costs (`readings.cost`), which fall with a power of the samples: a straight line in log-log.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .readings import HEADLINE, OURS, cost, denoising_ms, grouped, label, sample_of

MIN_SLOPE = -0.05  # of log cost over log samples: flatter curves have levelled off; noise alone has -1


def comparisons(rows: Sequence[dict], methods: dict[str, dict], sequences: dict[str, dict], us: str) -> list[dict]:
    """`compare` of `us` with every peer, a row a sequence, device, metric of HEADLINE and peer, errors of the frame."""
    found = []
    for group in grouped(rows, "sequence", "device"):
        sequence, device = group[0]["sequence"], group[0]["device"]
        sample = sample_of(sequence, sequences)
        peers = dict.fromkeys(label(r) for r in group if methods[r["method"]]["family"] not in OURS)
        for metric in HEADLINE:
            ours = curve(group, us, metric, methods)
            for peer in peers:
                theirs = curve(group, peer, metric, methods)
                if ours and theirs:
                    row = {"sequence": sequence, "device": device, "metric": metric, "peer": peer}
                    found.append(row | compare(ours, theirs, sample))
    return found


@dataclass(frozen=True)
class Curve:
    """One method on one sequence over samples per pixel, by one metric."""

    spp: tuple[int, ...]  # ascending
    cost: tuple[float, ...]
    ms: tuple[float, ...]  # of the denoiser

    def spp_for(self, wanted: float) -> tuple[float, bool] | None:
        """Samples at which the cost is `wanted`, interpolated log-log, and whether that is extrapolated.

        The fewest measured samples where they suffice; None where more samples do not help, or were not tried.
        """
        x, y, goal = np.log2(self.spp), np.log2(self.cost), math.log2(wanted)
        if y[0] <= goal:
            return float(self.spp[0]), False
        for i in range(len(x) - 1):
            if y[i + 1] <= goal:
                return float(2 ** (x[i] + (goal - y[i]) * (x[i + 1] - x[i]) / (y[i + 1] - y[i]))), False
        slope = (y[-1] - y[-2]) / (x[-1] - x[-2]) if len(x) > 1 else 0.0
        if slope >= MIN_SLOPE:
            return None
        return float(2 ** (x[-1] + (goal - y[-1]) / slope)), True

    def cost_at(self, spp: float) -> float | None:
        """The cost at that many samples, interpolated log-log; None outside of the measured range."""
        if not self.spp[0] <= spp <= self.spp[-1]:
            return None
        return float(2 ** np.interp(math.log2(spp), np.log2(self.spp), np.log2(self.cost)))

    def total(self, sample: float) -> np.ndarray:
        """Milliseconds of rendering and denoising at each of `spp`."""
        return np.array(self.spp) * sample + np.array(self.ms)


def curve(rows: Sequence[dict], name: str, metric: str, methods: dict[str, dict]) -> Curve | None:
    """The method with this `label` in the rows of one sequence on one device; None if it has no such errors."""
    found = sorted(
        (row["spp"], c, denoising_ms(row, methods))
        for row in rows
        if label(row) == name and (c := cost(metric, row["errors"]["frame"].get(metric))) is not None
    )
    return Curve(*zip(*found, strict=True)) if found else None


def compare(ours: Curve, peer: Curve, sample: float | None) -> dict:
    """The peer at our error, and at our time, both at our fewest samples; `sample`: render time of one in ms.

    equal_error   {"spp", "extrapolated", "ms": rendering and denoising, None if `sample` is None}; None where the peer
                  never reaches our error
    equal_time    {"spp": samples that the peer can afford, "cost_ratio": peer's cost over ours}; None where it cannot
                  afford one sample, its curve ends before, or `sample` is None
    area          {"factor", "from", "to"}: the mean of log(peer's cost / our cost) over log time, between the shortest
                  and the longest time in ms that both curves cover, as a factor: above 1 we are better
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


def _area(ours: Curve, peer: Curve, sample: float) -> dict | None:
    curves = (sorted(zip(curve.total(sample), np.log2(curve.cost), strict=True)) for curve in (ours, peer))
    (a, t), (b, u) = (np.transpose(curve) for curve in curves)  # by time: cheap samples may cost less than times vary
    start, end = max(a.min(), b.min()), min(a.max(), b.max())
    if not start < end:
        return None
    times = np.linspace(math.log2(start), math.log2(end), 65)
    difference = np.interp(times, np.log2(b), u) - np.interp(times, np.log2(a), t)
    return {"factor": float(2 ** difference.mean()), "from": float(start), "to": float(end)}
