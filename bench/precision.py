"""What bfloat16 costs in the picture: the shipped models on the bundled sequence.   python bench/precision.py"""

from __future__ import annotations

from harness import ROOT, cpu, origin, write  # first: it settles how torch waits

# isort: split
import numpy as np
import torch

import rtdenoise
from rtdenoise import models
from rtdenoise.color import display_exposure
from rtdenoise.metrics import psnr, relmse

RESULT = ROOT / "bench" / "results" / "precision.json"
SKIP = 1  # the first frame has no history


@torch.inference_mode()
def main() -> None:
    layers = ("reference", "reference_half")
    frames = list(rtdenoise.open_sequence(ROOT / "samples" / "mural", signal="indirect", layers=layers))
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    rows = []
    for name in models.available():
        images = {precision: denoise(name, precision, frames) for precision in ("fp32", "bf16")}
        for precision, results in images.items():
            pairs = list(zip(results, frames, strict=True))[SKIP:]
            rows.append({
                "model": name,
                "precision": precision,
                "psnr": float(np.mean([psnr(i, f.reference, scale) for i, f in pairs])),
                "relmse": float(np.mean([relmse(i, f.reference, scale, None, f.reference_half) for i, f in pairs])),
                "psnr_against_fp32": float(np.mean([
                    psnr(i, reference, scale) for i, reference in zip(results, images["fp32"], strict=True)
                ])) if precision != "fp32" else None,
            })  # fmt: skip
            print(rows[-1])
    write(RESULT, **origin({"torch": cpu()}), rows=rows)


def denoise(name: str, precision: str, frames: list[rtdenoise.Frame]) -> list[torch.Tensor]:
    denoiser, history, images = models.load(name, precision=precision), None, []
    for frame in frames:
        image, history = denoiser.step(frame, history)
        images.append(image)
    return images


if __name__ == "__main__":
    main()
