"""The C ops read and write inside their tensors only, and do nothing undefined, on hostile input too.

Small sizes and one kernel; `make fuzz` takes all kernels, types and layouts, up to 3840×2160.
"""

import json

from attack_sanitizers import KINDS, start

SIZES = ("1x1", "5x19")  # 18 columns and more are multiplied in tiles


def test_under_the_sanitizers():
    result = start(*SIZES, "--few")
    assert result.returncode == 0, result.stderr[-4000:]
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [f"{H}x{W}" for H, W in (row["size"] for row in rows)] == [*SIZES]
    for row in rows:
        assert row["ops"] >= 19 and row["calls"] >= 30 * len(KINDS), row
        assert row["not_finite"] == [], row
    assert set.intersection(*(set(row["left_out"]) for row in rows)) == set()
