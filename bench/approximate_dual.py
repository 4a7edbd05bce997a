"""Dual motion from a splat of backward motion, against the exact one from `motion_next`.

    python bench/approximate_dual.py CLIPS [SEQUENCE ...]    (clips of `rtdenoise render --clips`; folders of EXR files)

For every pair of consecutive frames: precision and recall of the approximate occlusion mask against the exact one; the
length of approximate minus exact dual motion inside the exact mask; and the error of the previous frame's reference,
fetched along traditional, approximate and exact dual motion, against this frame's, on the display transform, inside the
exact mask and in the whole frame.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import harness
import torch

from rtdenoise.color import display, display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.sequences import open_sequence
from rtdenoise.motion import dual_motion, occlusion_mask, on_screen
from rtdenoise.ops import warp
from rtdenoise.splat import DEPTH_TOLERANCE, splat_motion_next

TOLERANCES = (0.03, 0.1, 0.3)
METHODS = ("traditional", "approximate", "exact")


def compare(sequences: list, tolerance: float) -> dict[str, float]:
    """Sums over all pairs of all sequences, then ratios: a pixel counts as a pixel whichever frame it is in."""
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


def main(arguments: list[str]) -> None:
    torch.set_num_threads(1)
    clips = ClipDataset(arguments[0])
    sets = {"clips": [clips.load(i, signal="color") for i in range(len(clips))]}
    for folder in arguments[1:]:
        sets[Path(folder).name] = [list(open_sequence(folder, signal="color", layers=("reference",)))]
    results = {
        name: {"sequences": len(sequences)} | compare(sequences, DEPTH_TOLERANCE) for name, sequences in sets.items()
    }
    scan = [
        {"tolerance": t} | {k: v for k, v in compare(sets["clips"], t).items() if k.startswith("mask")}
        for t in TOLERANCES
    ]
    for name, result in results.items():
        print(name, result)
    for row in scan:
        print(row)
    harness.write(
        harness.ROOT / "bench" / "results" / "approximate_dual.json",
        **harness.origin({"torch": harness.cpu()}),
        results=results,
        depth_tolerance=scan,
    )


if __name__ == "__main__":
    main(sys.argv[1:])
