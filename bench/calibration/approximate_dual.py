"""Choose `DEPTH_TOLERANCE` of rtdenoise/constants.py: dual motion from a splat of backward motion, against exact dual
motion from `motion_next`.

python bench/calibration/approximate_dual.py CLIPS [SEQUENCE ...]    # a training set; folders of EXR files

For every pair of consecutive frames: precision and recall of the approximate occlusion mask against the exact one, and
the length of the difference between approximate and exact dual motion inside the exact mask. History error: the
previous frame's reference, fetched along traditional, approximate or exact dual motion, against this frame's, on the
display transform, inside the exact mask and over the frame.
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

from rtdenoise.color import display, display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.opening import open_sequence
from rtdenoise.motion import dual_motion, occlusion_mask, on_screen
from rtdenoise.ops import warp
from rtdenoise.splat import DEPTH_TOLERANCE, splat_motion_next

TOLERANCES = (0.03, 0.1, 0.3)
METHODS = ("traditional", "approximate", "exact")


def compare(sequences: list, tolerance: float) -> dict[str, float]:
    """Sums over all pairs of all sequences, then ratios, so that every pixel counts alike."""
    exact_pixels = marked = both = pixels = inside_pixels = 0
    lengths, inside, everywhere = [], dict.fromkeys(METHODS, 0.0), dict.fromkeys(METHODS, 0.0)
    for frames in sequences:
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        for before, now in pairwise(frames):
            exact = dual_motion(now.motion, before.motion_next)
            approximate = dual_motion(now.motion, splat_motion_next(now.motion, now.depth, before.depth, tolerance))
            truth, mask = (occlusion_mask(dual, now.motion) for dual in (exact, approximate))
            both += int((truth & mask).sum())
            exact_pixels, marked = exact_pixels + int(truth.sum()), marked + int(mask.sum())
            lengths.append((approximate - exact).norm(dim=1, keepdim=True)[truth & on_screen(exact)])
            used = {
                "traditional": now.motion,
                "approximate": torch.where(mask, approximate, now.motion),
                "exact": torch.where(truth, exact, now.motion),
            }
            seen = on_screen(now.motion) & on_screen(used["exact"]) & on_screen(used["approximate"])
            pixels, inside_pixels = pixels + int(seen.sum()), inside_pixels + int((truth & seen).sum())
            for name, motion in used.items():
                error = (display(warp(before.reference, motion), scale) - display(now.reference, scale)).abs()
                error = error.mean(dim=1, keepdim=True)
                inside[name] += error[truth & seen].sum().item()
                everywhere[name] += error[seen].sum().item()
    length = torch.cat(lengths)
    return {
        "uncovered_pixels": exact_pixels,
        "mask_precision": round(both / marked, 4),
        "mask_recall": round(both / exact_pixels, 4),
        "endpoint_error_px": {"median": round(length.median().item(), 3), "mean": round(length.mean().item(), 3)},
        "history_error_uncovered": {k: round(v / inside_pixels, 4) for k, v in inside.items()},
        "history_error_frame": {k: round(v / pixels, 5) for k, v in everywhere.items()},
    }


def main(folder: tyro.conf.Positional[Path], sequences: tyro.conf.Positional[tuple[Path, ...]] = ()) -> None:
    torch.set_num_threads(1)
    clips = ClipDataset(folder)
    sets = {"clips": [clips.load(i, signal="color") for i in range(len(clips))]}
    for sequence in sequences:
        sets[sequence.name] = [list(open_sequence(sequence, signal="color", layers=("reference",)))]
    results = {name: {"sequences": len(shots)} | compare(shots, DEPTH_TOLERANCE) for name, shots in sets.items()}
    scan = [
        {"tolerance": t} | {k: v for k, v in compare(sets["clips"], t).items() if k.startswith("mask")}
        for t in TOLERANCES
    ]
    for name, result in results.items():
        print(name, result)
    for row in scan:
        print(row)
    harness.publish(RESULTS / "approximate_dual.json", {"results": results, "depth_tolerance": scan})


if __name__ == "__main__":
    harness.run(main, __doc__)
