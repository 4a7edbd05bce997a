"""Ways to denoise a Cycles animation: error and time of each, how even skies stay, and how far shaders are from torch.

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/still-life --set still-life --frames 8
    $render shots/still-life-reference --set still-life --frames 8 --samples 256 --seed 77
    python bench/cycles.py shots/still-life shots/room

A shot's references lie in the folder of its name and "-reference"; `--set room` renders the other shot.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, ROOT, harness

# isort: split
import numpy as np
import torch
import tyro

from rtdenoise import load
from rtdenoise.color import display_exposure
from rtdenoise.data.exr import read_channels
from rtdenoise.data.output import read_result
from rtdenoise.data.sequences import Sequence, open_sequence
from rtdenoise.glsl import Pipeline
from rtdenoise.metrics import psnr, relmse
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options

RESULT = RESULTS / "cycles.json"
PAGES = (ROOT / "docs" / "use" / "blender.md",)
SKIP = 1  # frames: the first has no history
METHODS = {
    "rtdenoise denoise --offline": Options(offline=True),
    "rtdenoise denoise --lights": Options(lights=True),
    "rtdenoise denoise": Options(),
    "rtdenoise denoise --signal indirect --recombine": Options(signal="indirect", recombine=True),
}
NOISY = "as rendered"
OFF = 0.01  # relative error of a pixel of the sky that counts


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of noisy frames."""
    rows, skies, apart = [], [], []
    for shot in shots:
        references = open_sequence(f"{shot}-reference")
        truth = [frame.radiance for frame in references]
        scale = display_exposure(torch.cat(truth))
        rows.append(row(shot.name, NOISY, [frame.radiance for frame in open_sequence(shot)], truth, scale, None))
        for name, how in METHODS.items():
            with tempfile.TemporaryDirectory() as out:
                milliseconds = 1000 * denoise(str(shot), out, how).seconds / len(truth)
                sequence = open_sequence(shot, signal=how.signal)
                images = [
                    torch.from_numpy(read_result(Path(out), sequence, i, recombine=how.recombine))
                    for i in range(len(truth))
                ]
            rows.append(row(shot.name, name, images, truth, scale, milliseconds))
            skies.append({"shot": shot.name, "method": name, **even_sky(references, images)})
        apart.append({"shot": shot.name, **difference(shot)})
    content = {"rows": rows, "skies": skies, "shaders": apart}
    harness.publish(RESULT, content, digits=4, pages=PAGES, tables=tables)


def row(shot: str, method: str, images: list, truth: list, scale: float, milliseconds: float | None) -> dict:
    pairs = list(zip(images, truth, strict=True))[SKIP:]
    return {
        "shot": shot, "method": method, "milliseconds": milliseconds,
        "psnr": float(np.mean([psnr(image, reference, scale) for image, reference in pairs])),
        "relmse": float(np.mean([relmse(image, reference, scale) for image, reference in pairs])),
    }  # fmt: skip


def even_sky(references: Sequence, images: list) -> dict:
    """Pixels in which all samples of the reference saw the sky of one colour, and how many of them are off."""
    pixels, off, worst = 0, 0, 0.0
    for path, image in zip(references.paths, images, strict=True):
        names = [f"ViewLayer.Env.{c}" for c in "RGB"]
        sky = np.stack(list(read_channels(path, names).values()))
        colour = sky.reshape(3, -1).max(1).reshape(3, 1, 1)
        seen = (np.abs(sky - colour) <= 2e-3).all(0) & (colour > 0).all()
        error = (np.abs(image[0].numpy() - colour) / np.maximum(colour, 1e-6)).max(0)
        pixels, off = pixels + int(seen.sum()), off + int((error[seen] > OFF).sum())
        worst = max(worst, float(error[seen].max(initial=0)))
    return {"pixels": pixels, "off": off, "worst": worst}


def difference(shot: Path) -> dict:
    """Relative difference of shaders and torch in single precision: the greatest, and where albedo was above 2."""
    denoiser, history, pipeline, other = load(precision="fp32"), None, Pipeline.load("default"), None
    greatest, mirror, albedo = 0.0, 0.0, 0.0
    for frame in open_sequence(shot):
        with torch.inference_mode():
            image, history = denoiser.step(frame, history)
        shaded, other = pipeline.step(frame.map(torch.Tensor.numpy), other)
        error = (np.abs(shaded - image.numpy()) / (image.numpy() + 1e-2)).max(1)
        bright = frame.albedo.numpy().max(1)
        greatest, albedo = max(greatest, float(error.max())), max(albedo, float(bright.max()))
        mirror = max(mirror, float(error[bright > 2].max(initial=0)))
    return {"greatest": greatest, "greatest_on_mirrors": mirror, "greatest_albedo": albedo}


def tables(document: dict) -> dict[str, str]:
    shots = list(dict.fromkeys(row["shot"] for row in document["rows"]))
    lines = ["| | " + " | ".join(f"{shot}: PSNR | relMSE" for shot in shots) + " | ms a frame |"]
    lines.append("|---" * (2 * len(shots) + 2) + "|")
    for method in (NOISY, *METHODS):
        mine = [row for row in document["rows"] if row["method"] == method]
        cells = [f"{row['psnr']:.1f} dB | {row['relmse']:.4f}" for row in mine]
        times = [row["milliseconds"] for row in mine if row["milliseconds"]]
        time = f"{np.mean(times):.0f}" if times else "–"
        label = method if method == NOISY else f"`{method}`"
        lines.append(f"| {label} | {' | '.join(cells)} | {time} |")
    return {"cycles": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
