"""A strip of the page on combiners: noisy | denoised | corrected | with a second render | reference.

python bench/combine_strip.py CLIPS [--clip 0] [--spp 64] [--method default]

CLIPS as for `combine.py`. Shows the middle frame of one clip, each above its middle part, enlarged, and writes
docs/images/combine.webp.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, harness
from bench.combine import halves_of, window_at

# isort: split
import torch
import tyro

from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.models import load_combiner
from rtdenoise.run.preview import strip

PICTURE = DOCS / "images" / "combine.webp"
COMBINER = "combiner"
ENLARGED = 3  # times, by repeating pixels
QUALITY = 80  # of WebP


@torch.inference_mode()
def main(
    clips: tyro.conf.Positional[Path], clip: int = 0, signal: str = "color", spp: int = 64, method: str = "default"
) -> None:
    """Write the strip.

    Args:
        clips: Folder with a folder of clips for each sample count.
        clip: Number of the clip.
        signal: color or indirect.
        spp: Samples a pixel.
        method: The denoiser that is corrected.
    """
    both = ClipDataset(clips / f"spp{spp:02d}").load(clip, signal=signal, estimates=method)
    frames, estimates = both[: len(both) // 2], [frame.radiance for frame in both[len(both) // 2 :]]
    i, combiner, halves = len(frames) // 2, load_combiner(COMBINER), halves_of(clips, clip, signal, spp)
    window = window_at(i, combiner, frames, estimates, halves)
    images = {
        f"{spp} samples": frames[i].radiance,
        method: estimates[i],
        "corrected": combiner.combine(replace(window, halves=())).image,
        "two renders": combiner.combine(window).image,
        "reference": frames[i].reference,
    }
    panels = {label: torch.cat([image, _enlarged(image)], dim=2) for label, image in images.items()}
    strip(panels, display_exposure(frames[i].reference)).save(PICTURE, quality=QUALITY, method=6)
    print(f"{PICTURE}: {PICTURE.stat().st_size / 1e3:.0f} kB")


def _enlarged(image: torch.Tensor) -> torch.Tensor:
    """The middle of a picture, ENLARGED times as large, of the picture's width."""
    H, W = image.shape[2:]
    h, w = H // ENLARGED, W // ENLARGED
    part = image[:, :, (H - h) // 2 : (H + h) // 2, (W - w) // 2 : (W + w) // 2]
    whole = part.repeat_interleave(ENLARGED, 2).repeat_interleave(ENLARGED, 3)
    return torch.nn.functional.pad(whole, (0, W - whole.shape[3], 0, 0), mode="replicate")


if __name__ == "__main__":
    harness.run(main, __doc__)
