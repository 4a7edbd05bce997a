"""Ways to denoise a Cycles animation: error and time of each, every light pass against OIDN, how even skies stay, and
how far shaders are from torch.

    render="bpyenv/bin/python examples/blender/render.py"
    $render shots/still-life --set still-life --frames 8
    $render shots/still-life-reference --set still-life --frames 8 --samples 256 --seed 77
    python bench/cycles.py shots/still-life shots/room shots/turntable shots/meadow

A shot's references lie in the folder of its name and "-reference"; `--set` renders the other shots.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, ROOT, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor

from rtdenoise import load
from rtdenoise.baselines.oidn import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.exr import read_channels
from rtdenoise.data.light import find_light, read_light
from rtdenoise.data.opening import open_sequence
from rtdenoise.data.output import read_result
from rtdenoise.data.sequences import Sequence
from rtdenoise.frame import Frame
from rtdenoise.glsl import Pipeline
from rtdenoise.metrics import psnr, relmse
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options
from rtdenoise.sanitise import sanitise

RESULT = RESULTS / "cycles.json"
PAGES = (ROOT / "docs" / "use" / "blender.md",)
SKIP = 1  # frames: the first has no history
METHODS = {
    "rtdenoise denoise --offline": Options(offline=True),
    "rtdenoise denoise --offline --lights": Options(offline=True, lights=True, layout="source"),
    "rtdenoise denoise --lights": Options(lights=True, layout="source"),
    "rtdenoise denoise --lights --lookahead 0": Options(lights=True, layout="source", lookahead=0),
    "rtdenoise denoise": Options(),
    "rtdenoise denoise --lookahead 0": Options(lookahead=0),
    "rtdenoise denoise --signal indirect --recombine": Options(signal="indirect", recombine=True),
}
WHOLE, OIDN = "Intel OIDN 2", "Intel OIDN 2, each pass by itself"
OF_LIGHTS = {
    "rtdenoise denoise --lights": Options(lights=True, layout="source", float32=True),
    "rtdenoise denoise --lights --lookahead 0": Options(lights=True, layout="source", float32=True, lookahead=0),
    "rtdenoise denoise --lights --model default": Options(
        lights=True, layout="source", float32=True, model="default"
    ),
}
FAINT = 1e-4  # of the light: passes with less are black but for some pixels
NOISY = "as rendered"
OFF = 0.01  # relative error of a pixel of the sky that counts


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of noisy frames."""
    rows, lights, skies, apart = [], [], [], []
    for shot in shots:
        references = open_sequence(f"{shot}-reference")
        truth = [frame.radiance for frame in references]
        scale = display_exposure(torch.cat(truth))
        rows.append(row(shot.name, NOISY, [frame.radiance for frame in open_sequence(shot)], truth, scale, None))
        filters, started = Oidn(clean=True), time.perf_counter()
        images = [by_filters(filters, frame)(frame.radiance) for frame in open_sequence(shot)]
        rows.append(row(shot.name, WHOLE, images, truth, scale, 1000 * (time.perf_counter() - started) / len(truth)))
        for name, how in METHODS.items():
            with tempfile.TemporaryDirectory() as out:
                milliseconds = 1000 * denoise(str(shot), out, how).seconds / len(truth)
                sequence = open_sequence(shot, signal=how.signal)
                images = [
                    torch.from_numpy(read_result(Path(out), sequence, i, how.layout, how.recombine))
                    for i in range(len(truth))
                ]
            rows.append(row(shot.name, name, images, truth, scale, milliseconds))
            skies.append({"shot": shot.name, "method": name, **even_sky(references, images)})
        lights += light_rows(shot, references, scale)
        apart.append({"shot": shot.name, **difference(shot)})
    content = {"rows": rows, "lights": lights, "skies": skies, "shaders": apart}
    harness.publish(RESULT, content, digits=4, pages=PAGES, tables=tables)


def row(shot: str, method: str, images: list, truth: list, scale: float, milliseconds: float | None) -> dict:
    pairs = list(zip(images, truth, strict=True))[SKIP:]
    return {
        "shot": shot, "method": method, "milliseconds": milliseconds,
        "psnr": float(np.mean([psnr(image, reference, scale) for image, reference in pairs])),
        "relmse": float(np.mean([relmse(image, reference, scale) for image, reference in pairs])),
    }  # fmt: skip


def light_rows(shot: Path, references: Sequence, scale: float) -> list[dict]:
    """PSNR of every pass that is not black, in radiance, and of their sum. OIDN leaves those without noise as they
    are."""
    sequence = open_sequence(shot)
    truth = [radiances(references, i) for i in range(len(references))]
    light = {name: sum(frame[name].mean() for frame in truth) for name in truth[0]}
    passes = [name for name in light if light[name] > FAINT * light["Combined"]]
    found, spent = {}, {}
    found[OIDN], spent[OIDN] = by_oidn(sequence)
    for name, how in OF_LIGHTS.items():
        with tempfile.TemporaryDirectory() as out:
            spent[name] = denoise(str(shot), out, how).seconds
            clean = open_sequence(out)
            found[name] = [radiances(clean, i) for i in range(len(clean))]
    return [
        {"shot": shot.name, "method": method, "milliseconds": 1000 * spent[method] / len(truth), **{
            name: float(np.mean([psnr(a[name], b[name], scale) for a, b in zip(images, truth, strict=True)][SKIP:]))
            for name in passes
        }}
        for method, images in found.items()
    ]  # fmt: skip


def radiances(sequence: Sequence, index: int) -> dict[str, torch.Tensor]:
    """The passes of a frame `[1, 3, H, W]` and, named `Combined`, their sum."""
    passes = find_light(sequence, lights=True, also=())
    stored = read_light(sequence, index, passes)
    stored |= passes.radiance(stored)
    light = {name: torch.from_numpy(stored[name]) for name in passes.summands}
    return light | {"Combined": sum(light.values())}


def by_oidn(sequence: Sequence) -> tuple[list[dict[str, torch.Tensor]], float]:
    """OIDN's pictures of all passes, and the seconds they took."""
    filters, frames, seconds = Oidn(clean=True), [], 0.0
    without_noise = find_light(sequence, lights=True, also=()).passed
    for i in range(len(sequence)):
        light = radiances(sequence, i)
        del light["Combined"]
        started = time.perf_counter()
        denoised = by_filters(filters, sequence[i])
        for name, image in light.items():
            if name not in without_noise and image.any():
                light[name] = denoised(image)
        seconds += time.perf_counter() - started
        frames.append(light | {"Combined": sum(light.values())})
    return frames, seconds


def by_filters(filters: Oidn, frame: Frame) -> Callable[[Tensor], Tensor]:
    """What denoises light of a frame. Albedo and normal are filtered first, as in Cycles."""
    prepared = filters.prefiltered(sanitise(frame))
    return lambda light: filters.step(replace(prepared, radiance=light))[0]


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
    for method in (NOISY, WHOLE, *METHODS):
        mine = [row for row in document["rows"] if row["method"] == method]
        cells = [f"{row['psnr']:.1f} dB | {row['relmse']:.4f}" for row in mine]
        times = [row["milliseconds"] for row in mine if row["milliseconds"]]
        time = f"{np.mean(times):.0f}" if times else "–"
        label = f"`{method}`" if method in METHODS else method
        lines.append(f"| {label} | {' | '.join(cells)} | {time} |")
    return {"cycles": "\n".join(lines), "lights": of_lights(document["lights"])}


def of_lights(rows: list[dict]) -> str:
    """A column for each pass, a table for all shots."""
    names = [name for row in rows for name in row if name not in ("shot", "method", "milliseconds")]
    names = list(dict.fromkeys(names))
    lines = ["| | | " + " | ".join(names) + " | ms a frame |", "|---" * (len(names) + 3) + "|"]
    for row in rows:
        cells = [f"{row[name]:.1f}" if name in row else "–" for name in names]
        method = row["method"] if row["method"] == OIDN else f"`{row['method']}`"
        lines.append(f"| {row['shot']} | {method} | {' | '.join(cells)} | {row['milliseconds']:.0f} |")
    return "\n".join(lines)


if __name__ == "__main__":
    harness.run(main, __doc__)
