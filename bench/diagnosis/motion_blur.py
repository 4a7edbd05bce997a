"""What is it worth that frames with motion blur take the surfaces of a second render without it?

    render="bpyenv/bin/python examples/blender/render.py"
    $render blurred/drive --set drive --frames 8 --surfaces blurred/drive-surfaces    # likewise fan, pan, turntable
    $render blurred/drive-reference --set drive --frames 8 --samples 256 --seed 77 --surfaces unused
    python bench/diagnosis/motion_blur.py blurred/{drive,fan,pan,turntable}

PSNR at 1 sample a pixel, of all frames but the first: of single frames with layers as rendered, and of all methods with
those of `--surfaces`. Writes bench/results/motion_blur.json, the table of docs/notes/motion_blur.md, and for the first
two shots docs/images/motion-blur.webp.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import tyro
from PIL import Image

from bench.diagnosis.outdated import METHODS
from bench.diagnosis.turned import errors, paired
from bench.diagnosis.virtual_motion import table
from rtdenoise.color import display_exposure
from rtdenoise.data.opening import open_sequence
from rtdenoise.frame import Frame
from rtdenoise.run.options import Options
from rtdenoise.run.preview import strip
from rtdenoise.run.surfaces import with_surfaces

RESULT, PAGES = RESULTS / "motion_blur.json", (DOCS / "notes" / "motion_blur.md",)
PICTURE, SHOWN, QUALITY = DOCS / "images" / "motion-blur.webp", 5, 75  # a frame; quality of WebP
LAYERS = "as rendered", "of the second render"
BEST = "`hybrid` with `--lookahead 2`"
ALONE = [*METHODS][:2]  # what takes single frames: as rendered they have no motion


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of frames of Cycles, each with folders of its name and "-surfaces", and "-reference", beside
    it."""
    rows, strips = [], []
    for shot in shots:
        frames, images = {layers: read(shot, surfaces=layers == LAYERS[1]) for layers in LAYERS}, {}
        for method, run in METHODS.items():
            for layers in LAYERS if method in ALONE else LAYERS[1:]:
                images[method, layers] = run(frames[layers])
                psnr = errors(frames[layers], images[method, layers])["frame"]
                rows.append({"shot": shot.name, "method": method, "layers": layers, "psnr": psnr})
                print(rows[-1], flush=True)
        noisy = frames[LAYERS[0]][SHOWN]
        panels = {
            "1 sample": noisy.radiance,
            "alone": images[ALONE[1], LAYERS[0]][SHOWN],
            "with a second render": images[BEST, LAYERS[1]][SHOWN],
            "256 samples": noisy.reference,
        }
        strips.append(strip(panels, display_exposure(noisy.reference)))
    Image.fromarray(np.concatenate([np.asarray(picture) for picture in strips[:2]])).save(
        PICTURE, quality=QUALITY, method=6
    )
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def read(shot: Path, surfaces: bool) -> list[Frame]:
    """Sanitised frames with references."""
    noisy = replace(open_sequence(shot), soft_edges=not surfaces)
    if surfaces:
        noisy = with_surfaces(noisy, Options(surfaces=f"{shot}-surfaces"))
    return paired(noisy, f"{shot}-reference")


def tables(document: dict) -> dict[str, str]:
    """Section `motion-blur`: PSNR of each method and shot, with either layers."""
    return {"motion-blur": table(document, "layers", LAYERS)}


if __name__ == "__main__":
    harness.run(main, __doc__)
