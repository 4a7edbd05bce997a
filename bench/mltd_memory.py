"""How much memory do the networks for Metropolis renders need?

python bench/mltd_memory.py [--models mltd-small mltd] [--width 1280 --height 720]

Each model, with random weights in float32, denoises frames of random light in a process of its own, whose peak of
resident memory is read at the end, library and frames included. The result of a frame in strips is compared with that
of the whole on a small frame first. Writes bench/results/mltd_memory.json and the table of
docs/reference/models/mltd.md.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, ROOT, harness

# isort: split
import torch

from rtdenoise.frame import Frame
from rtdenoise.models import PRESETS, create, transformer
from rtdenoise.models.inference import prepare

RESULT, PAGES = RESULTS / "mltd_memory.json", (DOCS / "reference" / "models" / "mltd.md",)
TOLERANCE = 1e-4  # of the light, between strips and the whole


def main(
    models: tuple[str, ...] = ("mltd-small", "mltd"),
    width: int = 1280,
    height: int = 720,
    frames: int = 2,
    child: str = "",
) -> None:
    """Measure.

    Args:
        models: Presets.
        width: Of the frames, pixels.
        height: Likewise.
        frames: How many; from the second on there is a history.
        child: The one model to run in this process; for the script itself.
    """
    if child:
        print(json.dumps(run(child, width, height, frames)))
        return
    rows = []
    for model in models:
        command = [sys.executable, __file__, "--child", model, "--width", str(width), "--height", str(height),
                   "--frames", str(frames)]  # fmt: skip
        out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT).stdout
        rows.append({"model": model, **json.loads(out.splitlines()[-1])})
        print(rows[-1], flush=True)
    document = {"size": [width, height], "frames": frames, "rows": rows}
    harness.publish(RESULT, document, digits=4, pages=PAGES, tables=tables)


@torch.inference_mode()
def run(model: str, width: int, height: int, frames: int) -> dict[str, float]:
    """Peak memory in MB, CPU seconds of the last frame, and the MB of the history."""
    torch.manual_seed(0)
    denoiser = prepare(create(PRESETS[model]).eval().requires_grad_(False), torch.float32)
    small = frame(0, 96, 64)
    whole = denoiser.step(small)[0]
    pixels, transformer.STRIP_PIXELS = transformer.STRIP_PIXELS, 1
    apart = (denoiser.step(small)[0] - whole).abs().max().item()
    transformer.STRIP_PIXELS = pixels
    if apart > TOLERANCE:
        sys.exit(f"{model}: strips differ from the whole by {apart:.1e}")
    history, seconds = None, 0.0
    for number in range(frames):
        now, started = frame(number, width, height), time.process_time()
        _, history = denoiser.step(now, history)
        seconds = time.process_time() - started
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    carried = sum(t.nbytes for t in history.layers().values()) / 1e6
    return {"peak_mb": round(peak), "history_mb": round(carried), "cpu_seconds": seconds}


def frame(number: int, width: int, height: int) -> Frame:
    """Random light in two components, on a wall that moves."""
    g = torch.Generator().manual_seed(number)
    parts = torch.rand(1, 6, height, width, generator=g)
    motion = torch.full((1, 2, height, width), 1.3)
    return Frame(
        parts[:, :3] + parts[:, 3:], albedo=torch.rand(1, 3, height, width, generator=g),
        normal=torch.zeros(1, 3, height, width), depth=torch.ones(1, 1, height, width), motion=motion,
        motion_next=-motion, components=parts, number=number,
    )  # fmt: skip


def tables(document: dict) -> dict[str, str]:
    """Section `mltd-memory`."""
    width, height = document["size"]
    lines = [f"| at {width}×{height} | memory, peak | of it history, for the next frame | CPU time of a frame |",
             "|---|---|---|---|"]  # fmt: skip
    for row in document["rows"]:
        megabytes = f"{row['peak_mb']:.0f} MB | {row['history_mb']:.0f} MB"
        lines.append(f"| `{row['model']}` | {megabytes} | {row['cpu_seconds']:.0f} s |")
    return {"mltd-memory": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
