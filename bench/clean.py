"""How much of a reference's noise `rtdenoise clean` takes, and how much light.

    python bench/clean.py CLIPS [CLIPS ...]

Half of each reference's samples is denoised and compared with the other half, which is independent of it: what is
between the two is the error of the denoised one plus the noise of the other, and the latter is known, as half of what
is between the raw halves. So the error against the converged picture comes out without a converged picture. On the
display transform, in decibels; the mean of every third frame of every clip. The references that are trained on have
the samples of both halves, and so less of either error.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import harness
import numpy as np
import torch

from rtdenoise.baselines.oidn import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.layers import SIGNALS
from rtdenoise.metrics.image import decibels, mse, reference_mse

RESULT = harness.ROOT / "bench" / "results" / "clean.json"


def main(folders: list[Path]) -> None:
    rows = [{"folder": f.name, "signal": s, **errors(ClipDataset(f), s)} for f in folders for s in SIGNALS]
    for row in rows:
        print(row)
    harness.write(RESULT, **harness.origin({"oidn": harness.cpu()}), rows=rows)


@torch.inference_mode()
def errors(clips: ClipDataset, signal: str) -> dict[str, float]:
    oidn, found = Oidn(), []
    for index in range(len(clips)):
        frames = clips.load(index, signal=signal)
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for frame in frames[::3]:
            a = frame.reference_half
            b = (2 * frame.reference - a).clamp(min=0)
            cleaned = oidn.step(replace(frame, radiance=a))[0]
            noise = 2 * reference_mse(frame.reference, a, scale)  # of a half
            found.append((noise, mse(cleaned, b, scale) - noise, (cleaned.mean() / a.mean()).item()))
    noise, error, light = np.mean(found, axis=0)
    samples = np.mean([clips.facts(i)["reference_spp"] / 2 for i in range(len(clips))])
    return {"spp": samples, "raw_psnr": decibels(noise), "cleaned_psnr": decibels(error), "light": light}


if __name__ == "__main__":
    main([Path(argument) for argument in sys.argv[1:]])
