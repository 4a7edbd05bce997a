"""What is alpha of few samples worth as rendered, and with the denoised picture's edges?

    render="bpyenv/bin/python examples/blender/render.py"
    for set in still-life meadow turntable; do
        for n in 1 4 16; do $render shots/cut-$set-$n --set $set --transparent --frames 8 --samples $n; done
        $render shots/cut-$set-reference --set $set --transparent --frames 8 --samples 128 --seed 77
    done
    python bench/diagnosis/alpha.py shots/cut-still-life shots/cut-meadow shots/cut-turntable

Lays the frames of `denoise` over plates of one brightness, and compares with the references over the same plates: PSNR
where alpha is neither 0 nor 1 in the reference, in all frames but the first. Writes bench/results/alpha.json and the
table of docs/notes/alpha.md.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import tyro

from rtdenoise.data.alpha import denoise_alpha
from rtdenoise.data.exr import read_channels
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options

RESULT, PAGES = RESULTS / "alpha.json", (DOCS / "notes" / "alpha.md",)
SAMPLES, PLATES = (1, 4, 16), (0.3, 2.0)  # a pixel; radiance
MIXED = 0.01, 0.99  # alpha of the pixels that count
CYCLES = [f"ViewLayer.Combined.{c}" for c in "RGBA"]


def main(shots: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    """`shots`: folders of noisy frames, without "-1" and so on."""
    rows = []
    for shot in shots:
        truth = frames_of(Path(f"{shot}-reference"), CYCLES)[1:]
        for samples in SAMPLES:
            noisy = Path(f"{shot}-{samples}")
            with tempfile.TemporaryDirectory() as out:
                denoise(str(noisy), out, Options(float32=True, alpha="rendered", precision="fp32"))
                frames = frames_of(Path(out), "RGBA")[1:]
            smooth = [(picture, denoise_alpha(alpha, picture)) for picture, alpha in frames]
            ideal = [(picture, best) for (picture, _), (_, best) in zip(frames, truth, strict=True)]
            for name, found in (("as rendered", frames), ("denoised", smooth), ("the reference's", ideal)):
                row = {"sequence": shot.name, "samples": samples, "alpha": name}
                rows.append(row | {str(plate): over(plate, found, truth) for plate in PLATES})
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def frames_of(folder: Path, names: list[str] | str) -> list[tuple[np.ndarray, np.ndarray]]:
    """`layers` of each frame in a folder."""
    return [layers(path, names) for path in sorted(folder.glob("*.exr"))]


def layers(path: Path, names: list[str] | str) -> tuple[np.ndarray, np.ndarray]:
    """Picture `[H, W, 3]` and alpha `[H, W]` of a frame."""
    *picture, alpha = read_channels(path, names).values()
    return np.stack(picture, axis=2), alpha


def over(plate: float, frames: list, truth: list) -> float:
    """Mean PSNR in dB of mixed pixels, of the pictures as a display shows them."""
    found = []
    for (picture, alpha), (best, coverage) in zip(frames, truth, strict=True):
        mixed = (coverage > MIXED[0]) & (coverage < MIXED[1])
        a, b = (shown(x + plate * (1 - y[..., None]))[mixed] for x, y in ((picture, alpha), (best, coverage)))
        found.append(-10 * np.log10(np.square(a - b).mean()))
    return float(np.mean(found))


def shown(light: np.ndarray) -> np.ndarray:
    """Light as a display shows it, compressed, in [0, 1]: `color.display` would cut off what shines over a plate."""
    light = light.clip(0)
    return (light / (1 + light)) ** (1 / 2.2)


def tables(document: dict) -> dict[str, str]:
    """Section `alpha`: PSNR over each plate."""
    lines = ["| | samples a pixel | alpha | over grey | over a bright sky |", "|---|---|---|---|---|"]
    for row in document["rows"]:
        name = f"**{row['alpha']}**" if row["alpha"] == "denoised" else row["alpha"]
        values = " | ".join(f"{row[str(plate)]:.1f}" for plate in PLATES)
        lines.append(f"| {row['sequence'].removeprefix('cut-')} | {row['samples']} | {name} | {values} |")
    return {"alpha": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
