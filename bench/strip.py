"""The animated strip of the README: noisy | OIDN | rtdenoise, frame by frame, where flicker shows.

python bench/strip.py

Renders 16 frames of the bundled scene at 1 sample per pixel, which no network was trained on, into data/strip, unless
they are there, and denoises their beauty. OIDN's default mode takes every frame for itself.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, ROOT, harness

# isort: split

from PIL import Image

from rtdenoise.color import display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.evaluate import choose, outputs
from rtdenoise.run.preview import FRAMES_PER_SECOND, strip

FRAMES = ROOT / "data" / "strip"
PICTURE = DOCS / "images" / "flicker.webp"
COUNT = 16
METHODS = {"1 sample per pixel": "noisy", "Intel OIDN, frame by frame": "oidn", "rtdenoise": "hybrid"}
QUALITY = 60  # of WebP


def main() -> None:
    render = [sys.executable, "-m", "rtdenoise", "render", "sample", "--out", FRAMES, "--frames", str(COUNT)]
    subprocess.run([*map(str, render), "--reference-spp", "0"], check=True)
    frames = list(open_sequence(FRAMES))
    names = {method.name: method for method in choose(METHODS.values())}
    images = {
        label: [output.image for output in outputs(names[name].step(), frames)] for label, name in METHODS.items()
    }
    exposure = display_exposure(images["rtdenoise"][-1])
    panels = [strip({label: shown[i] for label, shown in images.items()}, exposure) for i in range(len(frames))]
    write(panels, PICTURE)
    print(f"{PICTURE}: {len(panels)} frames, {PICTURE.stat().st_size / 1e6:.2f} MB")


def write(pictures: list[Image.Image], path: Path) -> None:
    """An endless WebP animation of pictures of one size."""
    first, *rest = pictures
    first.save(
        path, save_all=True, append_images=rest, duration=1000 // FRAMES_PER_SECOND, loop=0, quality=QUALITY, method=6
    )


if __name__ == "__main__":
    harness.run(main, __doc__)
