"""Choose `OCCLUSION_THRESHOLD` of rtdenoise/frame.py: how far must dual and traditional motion differ for a pixel to
count as uncovered?

python bench/calibration/occlusion_threshold.py CLIPS    # a training set, whose clips have object ids

The ids give the truth: a pixel was hidden if its motion leads, at the nearest pixel of the previous frame, to another
object. Precision: the share of the mask that was hidden. Recall: the share of hidden pixels in the mask; it has a
ceiling, because motion vectors do not show an occluder that moves exactly as the background does.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import RESULTS, harness

# isort: split
import torch
import tyro

from rtdenoise.data.clips import ClipDataset
from rtdenoise.motion import dual_motion, on_screen
from rtdenoise.ops import fetch

THRESHOLDS = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)  # pixels


def main(folder: tyro.conf.Positional[Path]) -> None:
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
    content = {"clips": len(clips), "hidden_share": hidden_total / pixels, "rows": rows}
    harness.publish(RESULTS / "occlusion_threshold.json", content)


if __name__ == "__main__":
    harness.run(main, __doc__)
