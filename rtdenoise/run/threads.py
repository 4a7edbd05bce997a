"""Threads of torch and of the C operations: their number, and how they wait. Torch reads both as it loads."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

CGROUPS = Path("/sys/fs/cgroup")


def set_defaults() -> None:
    """Choose how OpenMP's threads wait and how many there are, through its environment variables. Variables that the
    user has set stay. Without effect once torch is loaded, so call it before.

    `OMP_WAIT_POLICY=passive`: by default threads spin while they wait and slow each other down wherever other
    processes run too. A frame took 271 ms with spinning threads and 48 ms with waiting ones on a busy two-core machine.
    `OMP_NUM_THREADS`: a container's share of the processors, if it is limited; torch does not look at that limit.
    """
    if "torch" in sys.modules:
        return
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    limit = cpu_limit()
    if limit is not None and limit < (os.cpu_count() or 1):
        os.environ.setdefault("OMP_NUM_THREADS", str(limit))


def cpu_limit(folder: Path = CGROUPS) -> int | None:
    """Processors that the control group of a container allows, rounded up; None without a limit. Linux only."""
    for file in ("cpu.max", "cpu/cpu.cfs_quota_us"):  # cgroup 2: "quota period"; cgroup 1: a file for each
        try:
            words = (folder / file).read_text(encoding="utf-8").split()
            if file != "cpu.max":
                words += (folder / "cpu/cpu.cfs_period_us").read_text(encoding="utf-8").split()
            quota, period = (int(word) for word in words)
        except (OSError, ValueError):  # no such file, or "max"
            continue
        if quota > 0 and period > 0:
            return math.ceil(quota / period)
    return None
