"""Commands killed at random moments, mid-sequence too, end with the files of an undisturbed run.

A few kills each; `make fuzz` does fifty, of `render` and `clips` too.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

KILLS = {"denoise": 4, "combine": 2, "evaluate": 1, "train": 1}


def test_killed_at_random_and_run_again():
    script = Path(__file__).parent / "attack_kills.py"
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(script.parents[1])}
    attacks = [f"{command}={count}" for command, count in KILLS.items()]
    result = subprocess.run([sys.executable, script, *attacks, "--cold"], capture_output=True, text=True,
                            env=environment)  # fmt: skip
    assert result.returncode == 0, result.stderr
    outcomes = [json.loads(line) for line in result.stdout.splitlines()]
    assert {found["command"]: found["kills"] for found in outcomes} == KILLS
    for found in outcomes:
        assert found["held"], found
