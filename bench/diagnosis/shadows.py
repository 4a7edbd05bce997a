"""What are shadows on a shadow catcher worth, which lie in alpha, as rendered and denoised as light?

    render="bpyenv/bin/python examples/blender/render.py"
    for n in 1 4 16 64; do $render shots/catcher-$n --set catcher --frames 8 --samples $n; done
    $render shots/catcher-reference --set catcher --frames 8 --samples 512 --seed 77
    python bench/diagnosis/shadows.py shots/catcher

Lays the frames of `denoise` over a grey plate, as bench/diagnosis/alpha.py does; the picture is the same with every
alpha. OIDN filters what alpha lets through, frame by frame, with albedo 1 and the normal. Writes
bench/results/shadows.json and the table of docs/notes/alpha.md.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro

from bench.diagnosis.alpha import CYCLES, frames_of, over
from rtdenoise.baselines import Oidn
from rtdenoise.data.opening import open_sequence
from rtdenoise.run.denoise import denoise
from rtdenoise.run.options import Options
from rtdenoise.sanitise import sanitise

RESULT, PAGES = RESULTS / "shadows.json", (DOCS / "notes" / "alpha.md",)
SAMPLES, PLATE = (1, 4, 16, 64), 0.3  # a pixel; radiance
RENDERED, OF_OIDN, DENOISED = "as rendered", "OIDN of what it lets through", "**denoised**"


def main(shot: tyro.conf.Positional[Path]) -> None:
    """`shot`: folders of noisy frames, without "-1" and so on."""
    truth = frames_of(Path(f"{shot}-reference"), CYCLES)
    rows = []
    for samples in SAMPLES:
        noisy = Path(f"{shot}-{samples}")
        with tempfile.TemporaryDirectory() as out:
            denoise(str(noisy), out, Options(float32=True, precision="fp32"))
            found = {DENOISED: frames_of(Path(out), "RGBA")}
        pictures = [picture for picture, _ in found[DENOISED]]
        for name, alphas in ((RENDERED, [alpha for _, alpha in frames_of(noisy, CYCLES)]), (OF_OIDN, of_oidn(noisy))):
            found[name] = list(zip(pictures, alphas, strict=True))
        for name in (RENDERED, OF_OIDN, DENOISED):
            rows.append({"samples": samples, "alpha": name, "psnr": over(PLATE, found[name][1:], truth[1:])})
            print(rows[-1], flush=True)
    harness.publish(RESULT, {"rows": rows}, digits=4, pages=PAGES, tables=tables)


def of_oidn(noisy: Path) -> list[np.ndarray]:
    """Alphas `[H, W]` of which OIDN has filtered 1 - alpha."""
    oidn, found = Oidn(), []
    for frame, (_, alpha) in zip(open_sequence(noisy), frames_of(noisy, CYCLES), strict=True):
        light = torch.from_numpy(1 - alpha).expand(1, 3, -1, -1)
        image, _ = oidn.step(replace(sanitise(frame), radiance=light, albedo=torch.ones_like(light)))
        found.append(1 - image[0].mean(0).numpy().clip(0, 1))
    return found


def tables(document: dict) -> dict[str, str]:
    """Section `shadows`: PSNR over the plate, at each number of samples."""
    found = {(row["samples"], row["alpha"]): row["psnr"] for row in document["rows"]}
    names = list(dict.fromkeys(name for _, name in found))
    lines = [f"| samples a pixel | {' | '.join(names)} |", "|---" * (len(names) + 1) + "|"]
    for samples in dict.fromkeys(samples for samples, _ in found):
        lines.append(f"| {samples} | {' | '.join(f'{found[samples, name]:.1f}' for name in names)} |")
    return {"shadows": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
