"""What does guided self-attention cost in time and memory, at 720p and at 4K?

python bench/attention_cost.py [--cases afgsa-small:1280x720 ...]

A frame of random light in a process of its own, with random weights, which cost the same as trained ones. Frames too
large for memory are denoised in windows (`GuidedAttention.filtered`). With `NAME:SIZE:1` only the largest window is:
its peak memory is that of the frame, and the time is that of the window times the frame's pixels in all windows. CPU
time, of all threads together. Writes bench/results/attention_cost.json and a section of docs/results/attention.md.
"""

from __future__ import annotations

import resource
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
from torch import Tensor

from rtdenoise.frame import Frame
from rtdenoise.models import STILLS, create
from rtdenoise.models.inference import prepare

RESULT, PAGES = RESULTS / "attention_cost.json", (DOCS / "results" / "attention.md",)
CASES = ("afgsa-small:1280x720", "afgsa:1280x720:1", "afgsa-small:3840x2160")


def main(cases: tuple[str, ...] = CASES, threads: int = 1) -> None:
    """Measure each case.

    Args:
        cases: NAME:WIDTHxHEIGHT, with :1 for the largest window alone.
        threads: Of torch.
    """
    rows = []
    for case in cases:
        with ProcessPoolExecutor(1, get_context("spawn")) as process:  # a fresh one: its peak memory is the case's own
            rows.append(process.submit(measure, case, threads).result())
        print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


@torch.inference_mode()
def measure(case: str, threads: int) -> dict:
    """Time and peak memory of one step."""
    name, size, *alone = case.split(":")
    width, height = map(int, size.split("x"))
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    model = prepare(create(STILLS[name]).eval().requires_grad_(False), torch.float32)
    light = torch.rand(1, 3, height, width)
    frame = Frame(light, albedo=light, normal=light, depth=light[:, :1] + 1)
    loaded = _peak()
    filtered, windows = model._filtered, []

    def counted(features: Tensor, light: Tensor) -> Tensor:
        windows.append(light.shape[2] * light.shape[3])
        return light

    model._filtered = counted
    model.step(frame)
    largest, done = max(windows), []

    def chosen(features: Tensor, light: Tensor) -> Tensor:
        pixels = light.shape[2] * light.shape[3]
        if alone and (done or pixels < largest):
            return light
        done.append(pixels)
        return filtered(features, light)

    model._filtered = chosen
    started = time.process_time()
    image, _ = model.step(frame)
    seconds = (time.process_time() - started) * sum(windows) / sum(done)
    return {
        "model": name, "size": [width, height], "windows": len(windows), "windows_measured": len(done),
        "overlap": sum(windows) / (width * height), "cpu_seconds": seconds,
        "seconds_per_megapixel": seconds / (width * height / 1e6), "peak_gb": _peak(), "before_gb": loaded,
        "finite": bool(image.isfinite().all()),
    }  # fmt: skip


def tables(document: dict) -> dict[str, str]:
    """Section `attention-cost`."""
    lines = ["| network | frame | windows | pixels computed | CPU seconds | a megapixel | peak memory |",
             "|---" * 7 + "|"]  # fmt: skip
    for row in document["rows"]:
        measured = "" if row["windows_measured"] == row["windows"] else ", from the largest window"
        lines.append(
            f"| `{row['model']}` | {row['size'][0]}×{row['size'][1]} | {row['windows']} | {row['overlap']:.2f}× | "
            f"{row['cpu_seconds']:.0f} s{measured} | {row['seconds_per_megapixel']:.1f} s | {row['peak_gb']:.2f} GB |"
        )
    return {"attention-cost": "\n".join(lines)}


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9


if __name__ == "__main__":
    harness.run(main, __doc__)
