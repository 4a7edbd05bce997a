"""How far dual and traditional motion must differ for a pixel to count as uncovered.

    python bench/occlusion_threshold.py CLIPS        (clips of `rtdenoise render --clips`, which have object ids)

The truth is taken from the ids: a pixel was hidden if its motion leads, at the nearest pixel of the previous frame, to
another object. Precision: how many pixels of the mask were hidden. Recall: how many hidden pixels are in the mask; an
occluder that moves exactly as the background does is no occlusion to motion vectors, so it has a ceiling.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import harness
import torch

from rtdenoise.data.clips import ClipDataset
from rtdenoise.motion import dual_motion, on_screen
from rtdenoise.ops import fetch

THRESHOLDS = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)


def main(folder: Path) -> None:
    clips = ClipDataset(folder)
    both, marked = torch.zeros(len(THRESHOLDS)), torch.zeros(len(THRESHOLDS))
    hidden_total = pixels = 0
    for index in range(len(clips)):
        for before, now in pairwise(clips.load(index)):
            hidden = (fetch(before.id, now.motion) != now.id) & on_screen(now.motion)
            distance = (dual_motion(now.motion, before.motion_next) - now.motion).norm(dim=1, keepdim=True)
            for i, threshold in enumerate(THRESHOLDS):
                mask = distance > threshold
                both[i] += (mask & hidden).sum()
                marked[i] += mask.sum()
            hidden_total += int(hidden.sum())
            pixels += hidden.numel()
    rows = [
        {"threshold_px": t, "precision": round((b / m).item(), 4), "recall": round((b / hidden_total).item(), 4),
         "share_of_pixels": round((m / pixels).item(), 4)}
        for t, b, m in zip(THRESHOLDS, both, marked, strict=True)
    ]  # fmt: skip
    for row in rows:
        print(row)
    harness.write(
        harness.ROOT / "bench" / "results" / "occlusion_threshold.json",
        **harness.origin({"torch": harness.cpu()}),
        clips=len(clips),
        hidden_share=hidden_total / pixels,
        rows=rows,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
