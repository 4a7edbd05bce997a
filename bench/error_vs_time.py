"""The standard set: every method on the sample and on rendered validation sequences, as one report.

    python bench/error_vs_time.py [SEQ ...]  renders what is missing into data/standard, measures it, and sequences of
                                             one's own, into out/standard, and keeps numbers and report:
                                             bench/results, docs/report
    python bench/error_vs_time.py --quick    four frames of the sample, nothing rendered, nothing kept: for CI

No model was trained on these scenes. Inputs at 2, 4 and 8 samples per pixel are rendered like those at 1 and share
their references. What one more sample costs the renderer on this machine is the slope of the time a frame between 2
and 8. Interrupted runs go on where they stopped.
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

from rtdenoise.evaluate.document import Document
from rtdenoise.evaluate.run import Options, run
from rtdenoise.models import available
from rtdenoise.report import report

DATA, OUT = harness.ROOT / "data" / "standard", harness.ROOT / "out" / "standard"
RESULT, KEPT = harness.ROOT / "bench" / "results" / "error_vs_time.json", harness.ROOT / "docs" / "report"
SPP = (2, 4, 8)  # beside 1
OVER_SPP = ("noisy", "accumulate", "oidn-fast", "oidn", "oidn-prefiltered", *available())
# The page is part of the repository, so it has pictures, beside references, of these alone.
PICTURES, SHOWN = ("oidn", "default"), ("mural", "street")


@dataclass(frozen=True)
class Sequence:
    """What `rtdenoise render` is asked for."""

    scene: str
    width: int = 320
    height: int = 180
    frames: int = 8
    reference_spp: int = 128


SEQUENCES = {
    "mural": Sequence("sample", frames=12),  # the bundled sample; only its inputs at more samples are rendered
    "window": Sequence("wide:2000002"),  # a room lit through a window, near objects cross the view
    "backdrop": Sequence("wide:2000010"),  # a fast object in front of black and white
    "outdoor": Sequence("wide:2000006", width=480, height=270),
}


def main(quick: bool, more: list[str]) -> None:
    started = time.perf_counter()
    if quick:
        sequences, out = [harness.ROOT / "samples" / "mural"], harness.ROOT / "out" / "quick"
        run([str(s) for s in sequences], out, Options(OVER_SPP, signal="indirect", frames=4))
    else:
        sequences, out = [prepare(name, wanted) for name, wanted in SEQUENCES.items()], OUT
        folders = [os.path.relpath(folder) for folder in sequences]  # no path of this machine in what is kept
        run(folders + more, out, Options(precisions=("fp32", "bf16"), signal="indirect"))
        run(folders, out, Options(OVER_SPP, spp=SPP, signal="indirect"))
    written = report(out) if quick else report(out, PICTURES, SHOWN)
    if not quick:
        keep(out, written)
    print(f"{', '.join(str(path) for path in written)}; {time.perf_counter() - started:.0f} s")


def prepare(name: str, wanted: Sequence) -> Path:
    """The sequence's folder with inputs at all sample counts and samples.json, rendered as far as it is missing."""
    folder = DATA / name
    if name == "mural":
        shutil.copytree(harness.ROOT / "samples" / "mural", folder, dirs_exist_ok=True)
    else:
        render(wanted, folder, 1, wanted.reference_spp)
    costs = folder / "samples.json"
    for spp in () if costs.exists() else SPP:  # their times are needed: an interrupted run left none
        shutil.rmtree(folder / f"spp{spp}", ignore_errors=True)
    seconds = {spp: render(wanted, folder / f"spp{spp}", spp, 0) for spp in SPP}
    if not costs.exists():
        slope = (np.median(seconds[SPP[-1]]) - np.median(seconds[SPP[0]])) / (SPP[-1] - SPP[0])
        facts = {"spp": 1, "sample_ms": round(1000 * float(slope), 2), "device": harness.cpu()}
        costs.write_text(json.dumps(facts) + "\n")
    return folder


def render(wanted: Sequence, out: Path, spp: int, reference_spp: int) -> list[float]:
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


def keep(out: Path, written: list[Path]) -> None:
    """The numbers into bench/results (without those of single frames), the report into docs."""
    KEPT.mkdir(parents=True, exist_ok=True)
    for path in written:
        shutil.copy(path, KEPT / path.name)
    document = vars(Document.read(out))
    document["results"] = [{k: v for k, v in row.items() if k != "frames"} for row in document["results"]]
    harness.write(RESULT, **(harness.origin({"torch": harness.cpu()}) | document))


if __name__ == "__main__":
    main(quick="--quick" in sys.argv[1:], more=[folder for folder in sys.argv[1:] if folder != "--quick"])
