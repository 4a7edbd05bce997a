"""Frames in tiles: equal to untiled ones, and 7680×4320 in bounded memory.

python bench/tiles.py [--size 7680x4320] [--tile 1024]

Two frames of a panning picture, with history: the bundled sequence, repeated to the size. At 640×360 the tiled result
is compared with the untiled one; at full size time and memory are measured and non-finite values are counted.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch

from rtdenoise.frame import Frame
from rtdenoise.models import load
from rtdenoise.run.tiles import Tiled

RESULT, PAGES = RESULTS / "tiles.json", (DOCS / "results" / "stability.md",)
MODEL = "default"
SHIFT = 3.25  # pixels per frame that everything moves to the left


@torch.inference_mode()
def main(size: str = "7680x4320", tile: int = 1024) -> None:
    width, height = map(int, size.split("x"))
    denoiser = load(MODEL, precision="fp32")
    whole, tiled = (_second(model, _frames(640, 360)) for model in (denoiser, Tiled(denoiser, 256)))
    error = harness.check("tiles", tiled.numpy(), whole.numpy(), "float32 tiles")

    started = time.perf_counter()
    image = _second(Tiled(denoiser, tile), _frames(width, height))
    seconds = time.perf_counter() - started
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    non_finite = int((~image.isfinite()).sum())
    print(f"{width}×{height}: {seconds:.0f} s for two frames, {memory:.1f} GB at most, {non_finite} values not finite")
    content = {
        "model": MODEL,
        "reach": Tiled(denoiser).reach,
        "equal": {"size": [640, 360], "tile": 256, "greatest_error": error},
        "large": {"size": [width, height], "tile": tile, "seconds": seconds, "peak_memory_gb": round(memory, 2),
                  "non_finite": non_finite, "frames": 2},
    }  # fmt: skip
    harness.publish(RESULT, content, pages=PAGES, tables=tables)


def tables(document: dict) -> dict[str, str]:
    """Section `tiles`."""
    equal, large = document["equal"], document["large"]
    small, size = (f"{s[0]}×{s[1]}" for s in (equal["size"], large["size"]))
    return {
        "tiles": f"`{document['model']}` reaches {document['reach']} pixels. {small} in tiles of {equal['tile']}: "
        f"greatest error {equal['greatest_error']:.1g}. {size} in tiles of {large['tile']}: "
        f"{large['peak_memory_gb']} GB at most, {large['non_finite']} values not finite "
        f"(`{document['command']}`, [JSON](../../bench/results/tiles.json))."
    }


def _second(denoiser, frames: Iterator[Frame]) -> torch.Tensor:
    _, history = denoiser.step(next(frames))
    return denoiser.step(next(frames), history)[0]


def _frames(width: int, height: int) -> Iterator[Frame]:
    """Two frames of the bundled sequence, repeated to this size; everything moves alike."""
    for frame in harness.mural("color")[:2]:
        H, W = frame.size
        wide = frame.map(lambda t, H=H, W=W: t.repeat(1, 1, -(-height // H), -(-width // W))[:, :, :height, :width])
        yield replace(
            wide, motion=torch.full_like(wide.motion, -SHIFT), motion_next=torch.full_like(wide.motion, SHIFT)
        )


if __name__ == "__main__":
    harness.run(main, __doc__)
