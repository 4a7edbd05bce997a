"""The standard set: sequences that no model was trained on, rendered into data/standard as far as they are missing.

Scene files are not part of the repository: sequences rendered from them are named on a bench's command line, beside
these (docs/quality.md says how they were rendered).
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import harness
import numpy as np

DATA = harness.ROOT / "data" / "standard"
SPP = (2, 4, 8)  # inputs beside those at 1


@dataclass(frozen=True)
class Sequence:
    """What `rtdenoise render` is asked for."""

    scene: str
    width: int = 320
    height: int = 180
    frames: int = 16
    reference_spp: int = 128


SEQUENCES = {
    "mural": Sequence("sample", frames=9),  # the bundled sample; only its inputs at more samples are rendered
    "window": Sequence("wide:2000002"),  # a room lit through a window, near objects cross the view
    "backdrop": Sequence("wide:2000010"),  # a fast object in front of black and white
    "outdoor": Sequence("wide:2000006", width=480, height=270),
}


def prepare() -> list[str]:
    """Folders of all sequences, relative to where we are: no path of this machine in what is kept."""
    return [os.path.relpath(_base(name, wanted)) for name, wanted in SEQUENCES.items()]


def add_samples() -> None:
    """Render the inputs at more samples into the sequences that `prepare` made, with what a sample costs.

    That is the slope of the time a frame between 2 and 8 samples on this machine (samples.json).
    """
    for name, wanted in SEQUENCES.items():
        folder = DATA / name
        costs = folder / "samples.json"
        for spp in () if costs.exists() else SPP:  # their times are needed: an interrupted run left none
            shutil.rmtree(folder / f"spp{spp}", ignore_errors=True)
        seconds = {spp: _render(wanted, folder / f"spp{spp}", spp, 0) for spp in SPP}
        if not costs.exists():
            slope = (np.median(seconds[SPP[-1]]) - np.median(seconds[SPP[0]])) / (SPP[-1] - SPP[0])
            facts = {"spp": 1, "sample_ms": round(1000 * float(slope), 2), "device": harness.cpu()}
            costs.write_text(json.dumps(facts) + "\n")


def _base(name: str, wanted: Sequence) -> Path:
    folder = DATA / name
    if name == "mural":
        shutil.copytree(harness.ROOT / "samples" / "mural", folder, dirs_exist_ok=True)
    else:
        _render(wanted, folder, 1, wanted.reference_spp)
    return folder


def _render(wanted: Sequence, out: Path, spp: int, reference_spp: int) -> list[float]:
    """Run `rtdenoise render`; seconds from each frame to the next, empty where nothing was missing."""
    command = [
        sys.executable, "-u", "-m", "rtdenoise", "render", wanted.scene, "--out", str(out), "--spp", str(spp),
        "--width", str(wanted.width), "--height", str(wanted.height), "--frames", str(wanted.frames),
        "--reference-spp", str(reference_spp),
    ]  # fmt: skip
    print("$", " ".join(command[3:]), flush=True)
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        finished = [time.perf_counter() for _ in process.stdout]
    if process.returncode:
        sys.exit(f"rendering failed: {' '.join(command)}")
    return list(np.diff(finished))
