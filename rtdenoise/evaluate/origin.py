"""The origin of measurements: command, date, commit, devices and versions, for every file of results."""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import torch

ROOT = Path(__file__).parents[2]
LIBRARIES = ("torch", "numpy", "moderngl")


def origin(command: str, devices: dict[str, str], libraries: Sequence[str] = LIBRARIES) -> dict[str, object]:
    """The origin of results measured now by this process."""
    return {
        "command": command,
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": commit(),
        "devices": devices,
        "omp_wait_policy": os.environ.get("OMP_WAIT_POLICY", "unset"),
        "versions": {"python": platform.python_version()} | {n: v for n in libraries if (v := _version(n))},
    }


def typed() -> str:
    """The command line of this process as a user would type it."""
    name = Path(sys.argv[0]).name
    program = ["rtdenoise"] if name in ("rtdenoise", "__main__.py") else ["python", sys.argv[0]]
    return shlex.join([*program, *sys.argv[1:]])


def device_name(device: str | torch.device = "cpu") -> str:
    """The graphics card, or the processor and the number of its threads that torch uses."""
    if torch.device(device).type == "cuda":
        return torch.cuda.get_device_name(device)
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{models[0] if models else platform.processor()}, {torch.get_num_threads()} of {os.cpu_count()} threads"


def commit() -> str:
    """The commit, with -dirty where the code differs from it; `unknown` without git, and outside a repository of this
    project."""

    def git(*arguments: str) -> str:
        return subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True).stdout.strip()

    # Installed: a repository around it is another's. A copy without its history may be where there is no git.
    if not (ROOT / "pyproject.toml").is_file() or not shutil.which("git"):
        return "unknown"
    changed = git("status", "--porcelain", "--", "rtdenoise", "shaders", "samples", "bench", ":!bench/results")
    return (git("rev-parse", "--short", "HEAD") or "unknown") + ("-dirty" if changed else "")


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return ""
