"""The standard set: sequences that no model was trained on, rendered into data/standard where they are missing.

Scene files are not part of the repository. Sequences rendered from them are named on a benchmark's command line
(docs/results/quality.md says how they were rendered).
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

import numpy as np

from .. import ROOT, SAMPLE
from .publish import cpu

DATA = ROOT / "data" / "standard"
SPP = (2, 4, 8)  # samples per pixel of further inputs, beside those at 1


@dataclass(frozen=True)
class Sequence:
    """Options of `rtdenoise render`."""

    scene: str
    width: int = 320
    height: int = 180
    frames: int = 16
    reference_spp: int = 640  # noise of fewer is bent by the display transform, which no metric corrects


SEQUENCES = {
    "mural": Sequence("sample", frames=9),  # the bundled sample; only its inputs at more samples are rendered
    "window": Sequence("wide:2000002"),  # a room lit through a window, near objects cross the view
    "backdrop": Sequence("wide:2000010"),  # a fast object in front of black and white
    "outdoor": Sequence("wide:2000006", width=480, height=270),
}


def prepare() -> list[str]:
    """Render missing sequences; return the folders of all, relative to the current folder so that results hold no path
    of this machine."""
    return [os.path.relpath(_base(name, wanted)) for name, wanted in SEQUENCES.items()]


def add_samples() -> None:
    """Render inputs at more samples into the sequences that `prepare` made, and the cost of a sample into samples.json:
    the slope of the time per frame between 2 and 8 samples on this machine."""
    for name, wanted in SEQUENCES.items():
        folder = DATA / name
        costs = folder / "samples.json"
        for spp in () if costs.exists() else SPP:  # render inputs again that an interrupted run did not time
            shutil.rmtree(folder / f"spp{spp}", ignore_errors=True)
        seconds = {spp: _render(wanted, folder / f"spp{spp}", spp, 0) for spp in SPP}
        if not costs.exists():
            slope = (np.median(seconds[SPP[-1]]) - np.median(seconds[SPP[0]])) / (SPP[-1] - SPP[0])
            facts = {"spp": 1, "sample_ms": round(1000 * float(slope), 2), "device": cpu()}
            costs.write_text(json.dumps(facts) + "\n")


def _base(name: str, wanted: Sequence) -> Path:
    folder = DATA / name
    if name == "mural":
        shutil.copytree(SAMPLE, folder, dirs_exist_ok=True)
    else:
        _render(wanted, folder, 1, wanted.reference_spp)
    return folder


def _render(wanted: Sequence, out: Path, spp: int, reference_spp: int) -> list[float]:
    """Run `rtdenoise render`; return the seconds between finished frames, none where all frames were there."""
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
