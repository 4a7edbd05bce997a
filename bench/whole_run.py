"""Time of a frame from file to file: `rtdenoise denoise` as a whole, reading and writing included.

python bench/whole_run.py            # 1280×720: the bundled sequence, enlarged and with new noise
python bench/whole_run.py --frames 8 --scale 1 --out quick.json

Two runs of each mode, of few and of many frames: their difference is the time of the frames between, without that of
the start. Times on a busy machine say nothing.
"""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, SAMPLE, harness

# isort: split

from rtdenoise.data.exr import read_channels, read_header, write_layers

RESULT, PAGES = RESULTS / "whole_run.json", (DOCS / "results" / "performance.md",)
ONE = ["--samples", "1"]  # enlarged noise is taken for that of more
MODES = {
    "nothing: `hybrid`, six frames ahead": ONE, "`--lookahead 0`": [*ONE, "--lookahead", "0"],
    "`--model default`": ["--model", "default"],
}  # fmt: skip
FEW = 4  # frames of the short run


@dataclass(frozen=True)
class Options:
    frames: int = 24
    """Of the long run."""
    scale: int = 4
    """Pixels along each side for one of the bundled sequence, 320×180."""
    out: Path = RESULT
    """JSON file; that of bench/results updates the page, too."""


def main(o: Options) -> None:
    with tempfile.TemporaryDirectory() as folder:
        short, long, out = (Path(folder) / name for name in ("short", "long", "out"))
        size = enlarged(short, FEW, o.scale)
        enlarged(long, o.frames, o.scale)
        timed(short, out / "warm", [])  # compiles
        rows = []
        for mode, arguments in MODES.items():
            few, many = (timed(shot, out / shot.name, arguments) for shot in (short, long))
            each = [(b - a) / (o.frames - FEW) * 1e3 for a, b in zip(few[:2], many[:2], strict=True)]
            rows.append({"mode": mode, "wall_ms": each[0], "cpu_ms": each[1], "step_ms": many[2]})
    where = {"pages": PAGES, "tables": tables} if o.out == RESULT else {}
    document = harness.publish(o.out, {"size": size, "frames": o.frames, "rows": rows}, **where)
    print(tables(document)["whole-run"])


def tables(document: dict) -> dict[str, str]:
    """Section `whole-run`."""
    W, H = document["size"]
    lines = [f"| {W}×{H}, `rtdenoise denoise` with | ms a frame | processor time, ms | of it its step takes, ms |",
             "|---|---|---|---|"]  # fmt: skip
    for row in document["rows"]:
        lines.append(f"| {row['mode']} | {row['wall_ms']:.0f} | {row['cpu_ms']:.0f} | {row['step_ms']:.0f} |")
    return {"whole-run": "\n".join(lines)}


def enlarged(folder: Path, frames: int, scale: int) -> tuple[int, int]:
    """Write so many frames; (W, H). Beyond the last one of the bundled sequence it begins anew."""
    folder.mkdir()
    rng, sources = np.random.default_rng(0), sorted(SAMPLE.glob("*.exr"))
    for number in range(frames):
        source = sources[number % len(sources)]
        header = read_header(source)
        layers = read_channels(source, [*header.channels])
        for name, plane in layers.items():
            plane = plane.repeat(scale, 0).repeat(scale, 1)
            plane = plane * scale if name.startswith("motion") else plane
            noisy = name in ("R", "G", "B") or name.startswith("indirect")
            layers[name] = plane * rng.exponential(1, plane.shape).astype(np.float32) if noisy else plane
        write_layers(folder / f"frame.{number:04d}.exr", layers, dtypes=dict.fromkeys(layers, "half"))
    return plane.shape[1], plane.shape[0]


def timed(shot: Path, out: Path, arguments: list[str]) -> tuple[float, float, float]:
    """Seconds of a run, of processors meanwhile, and milliseconds of a step as the run tells them."""
    command = [sys.executable, "-m", "rtdenoise", "denoise", str(shot), "--out", str(out), "--overwrite", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    before, started = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    told = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    seconds, after = time.monotonic() - started, resource.getrusage(resource.RUSAGE_CHILDREN)
    processors = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, processors, float(re.search(r"([\d.]+) ms a frame", told.stdout + told.stderr)[1])


if __name__ == "__main__":
    harness.run(main, __doc__)
