"""`denoise` with less and less address space (ulimit -v): it ends with its files, or in one line.

python tests/attack_memory.py MEGABYTES ...     prints a line of JSON for each limit
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from synthetic import make_frames, write_sequence


def attack(megabytes: int, shot: Path, out: Path) -> dict[str, object]:
    """One run under a limit: its exit code, the lines on stderr, and whether it held."""
    limit = megabytes * 10**6
    result = subprocess.run(
        [sys.executable, "-m", "rtdenoise", "denoise", str(shot), "--out", str(out), "--overwrite"],
        capture_output=True, text=True, cwd=Path(__file__).parents[1],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
    )  # fmt: skip
    written = len(list(out.glob("frame.*.exr")))
    lines = result.stderr.splitlines()
    refused = result.returncode == 2 and len(lines) == 1 and lines[0].startswith("rtdenoise: ")
    done = result.returncode == 0 and written == len(list(shot.glob("*.exr")))
    return {
        "megabytes": megabytes,
        "code": result.returncode,
        "line": lines[-1] if lines else "",
        "held": done or refused,
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        frames = write_sequence(Path(place) / "shot", make_frames(2, H=1080, W=1920))
        for number in map(int, sys.argv[1:]):
            print(json.dumps(attack(number, frames, Path(place) / "out")), flush=True)
