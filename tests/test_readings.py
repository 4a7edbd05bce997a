"""The readings of the report, on numbers with known conclusions."""

import pytest

from rtdenoise.report.budgets import Curve, compare
from rtdenoise.report.readings import (
    POOL,
    cost,
    front,
    losses_and_wins,
    mark_fronts,
    pooled,
    speaks_for_us,
)

METHODS = {
    "noisy": {"family": "input"}, "oidn": {"family": "oidn"}, "svgf": {"family": "filter"},
    "paper": {"family": "network"}, "paper-spatial": {"family": "ablation"},
}  # fmt: skip
MONTE_CARLO = Curve((1, 2, 4, 8), (1.0, 0.5, 0.25, 0.125), (0.0, 0.0, 0.0, 0.0))


def row(method, psnr, ms, spp=1, sequence="a"):
    errors = {region: {"psnr": psnr, "relmse": 10 ** (-psnr / 10)} for region in ("frame", "uncovered")}
    return {
        "sequence": sequence, "spp": spp, "method": method, "precision": "fp32", "device": "cpu", "run": 0,
        "ms": {"median": ms, "iqr": 0.0, "steps": 9}, "errors": errors, "ghost_length": None, "frames": [],
    }  # fmt: skip


def test_the_front_is_what_nothing_beats():
    points = [(1, 9.0), (2, 5.0), (2, 6.0), (3, 5.0), (4, 1.0), (5, None), (9, 0.5)]
    assert front(points) == [0, 1, 4, 6]


def test_costs_are_lower_the_better():
    assert cost("psnr", 20.0) == pytest.approx(0.01) and cost("psnr", 30.0) < cost("psnr", 20.0)
    assert cost("ssim", 0.75) == pytest.approx(0.25) and cost("relmse", 0.2) == 0.2
    assert cost("relmse", -0.001) is None and cost("psnr", None) is None


def test_samples_for_an_error_are_read_off_the_line():
    assert MONTE_CARLO.spp_for(1 / 3) == (pytest.approx(3), False)
    assert MONTE_CARLO.spp_for(1 / 64) == (pytest.approx(64), True)
    assert MONTE_CARLO.spp_for(2.0) == (1, False)  # it is as good with the fewest there are
    assert MONTE_CARLO.cost_at(3) == pytest.approx(1 / 3) and MONTE_CARLO.cost_at(9) is None


def test_what_has_levelled_off_gets_nowhere():
    assert Curve((1, 8), (0.5, 0.5), (0, 0)).spp_for(0.1) is None
    assert Curve((1,), (0.5,), (0,)).spp_for(0.1) is None


def test_equal_error_and_equal_time():
    ours = Curve((1, 2, 4, 8), (0.2, 0.1, 0.05, 0.025), (30.0,) * 4)
    found = compare(ours, MONTE_CARLO, sample=10.0)
    assert found["equal_error"] == {"spp": pytest.approx(5), "extrapolated": False, "ms": pytest.approx(50)}
    assert found["equal_time"] == {"spp": 4.0, "cost_ratio": pytest.approx(0.25 / 0.2)}  # 10 + 30 ms buy 4 samples
    unknown = compare(ours, MONTE_CARLO, sample=None)
    assert unknown["equal_error"]["ms"] is None and unknown["equal_time"] is None and unknown["area"] is None


def test_the_area_is_the_mean_ratio_over_budgets():
    ours = Curve((1, 2, 4, 8), (0.5, 0.25, 0.125, 0.0625), (0.0,) * 4)
    assert compare(ours, MONTE_CARLO, 10.0)["area"] == {"factor": pytest.approx(2.0), "from": 10, "to": 80}
    slow = Curve((1, 8), (0.5, 0.0625), (1e6, 1e6))
    assert compare(slow, MONTE_CARLO, 10.0)["area"] is None


def test_the_area_is_by_time_where_more_samples_took_less():
    ours = Curve((1, 2, 4), (1.0, 1.0, 1.0), (11.0, 12.0, 12.0))
    peer = Curve((1, 2, 4), (2.0, 1.0, 0.5), (14.0, 12.0, 9.0))  # 15, 14, 13 ms with the rendering
    assert compare(ours, peer, 1.0)["area"] == {"factor": pytest.approx(1, rel=0.05), "from": 13, "to": 15}


def test_losses_are_told_from_wins_and_ablations_are_no_peers():
    rows = [row("paper", 24, 10), row("paper-spatial", 30, 10), row("oidn", 25, 5), row("svgf", 20, 5)]
    lost, won = losses_and_wins(rows, METHODS, "paper")
    assert not won and {(r["metric"], r["region"], r["peer"]) for r in lost} == {
        (metric, region, "oidn") for metric in ("psnr", "relmse") for region in ("frame", "uncovered")
    }
    assert lost[0]["time_ratio"] == 0.5
    lost, won = losses_and_wins([row("paper", 26, 10), row("oidn", 25, 5)], METHODS, "paper")
    assert not lost and len(won) == 4


def test_fronts_leave_the_input_out_unless_rendering_counts():
    rows = [row("noisy", 10, 1), row("noisy", 19, 1, spp=8), row("oidn", 18, 40), row("paper", 17, 90)]
    mark_fronts(rows, {"a": {"sample_ms": 10.0}}, METHODS)
    assert [r["front"]["frame"] for r in rows] == [[], [], ["psnr", "relmse"], []]
    assert [bool(r["front_total"]["frame"]) for r in rows] == [True, True, True, False]
    mark_fronts(rows, {"a": {"sample_ms": None}}, METHODS)
    assert not any(r["front_total"]["frame"] for r in rows)


def test_a_pool_holds_what_was_measured_everywhere():
    rows = [row("oidn", 20, 4), row("oidn", 30, 9, sequence="b"), row("paper", 22, 9)]
    (found,) = pooled(rows, {"a": {}, "b": {}})
    assert found["sequence"] == POOL and found["method"] == "oidn"
    assert found["errors"]["frame"]["psnr"] == 25 and found["ms"]["median"] == pytest.approx(6)
    assert pooled(rows, {"a": {}}) == []


def test_the_best_preset_speaks_for_us():
    assert speaks_for_us([row("paper", 1, 1), row("oidn", 1, 1)], METHODS) == "paper"
    known = METHODS | {"default": {"family": "network"}}
    assert speaks_for_us([row("paper", 1, 1), row("default", 1, 1)], known) == "default"
    assert speaks_for_us([row("oidn", 1, 1)], METHODS) == ""


def test_where_no_preferred_network_was_measured_the_best_speaks_for_us():
    known = METHODS | {name: {"family": "network"} for name in ("first", "mine", "other")}
    rows = [row(name, psnr, 1) for name, psnr in (("other", 24), ("first", 11), ("mine", 25), ("oidn", 30))]
    assert speaks_for_us(rows, known) == "mine"
    assert speaks_for_us([*rows, row("mine", 20, 1, sequence="b"), row("other", 23, 1, sequence="b")], known) == "other"
    for one in rows:
        del one["errors"]["frame"]["psnr"]
    assert speaks_for_us(rows, known) == "first"
