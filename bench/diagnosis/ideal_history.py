"""What would history be worth if motion cost nothing? The network on the mean of k frames that nothing moved between.

python bench/diagnosis/ideal_history.py CLIPS [--weights default]

CLIPS/spp01, CLIPS/spp02 ... hold the same frames at nested sample counts (`combine_clips.py`). A frame of k samples a
pixel is the mean of k frames of one sample that nothing moved between, so it stands for a perfect history: the network
gets it as its running mean, of length k, beside the current frame of one sample; its previous output is a denoised one
of the same view. OIDN gets the frame of k samples as it is, and so does the network once more, as a first frame. *Real*
is the last frame of the clip, with the history of those before it. Corrected PSNR of that frame in all cases. Writes
bench/results/ideal_history.json and the table of docs/notes/long_history.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import numpy as np
import torch
import tyro
from torch import Tensor

from rtdenoise.baselines import Oidn
from rtdenoise.color import display_exposure
from rtdenoise.data.clips import ClipDataset
from rtdenoise.evaluate.sequence import outputs
from rtdenoise.frame import Frame, History
from rtdenoise.metrics import psnr_corrected
from rtdenoise.models import Denoiser, load
from rtdenoise.ops.pixels import demodulate

RESULT, PAGES = RESULTS / "ideal_history.json", (DOCS / "notes" / "long_history.md",)
SIGNALS = ("indirect", "color")
WAYS = {"ideal": "ideal history", "real": "its history as it is", "first": "first frame of so many samples"}
ROUNDS = 4  # steps on the same mean, until the previous output has settled


@torch.inference_mode()
def main(
    folder: tyro.conf.Positional[Path],
    weights: tuple[str, ...] = ("default",),
    levels: tuple[int, ...] = (2, 4, 8, 16),
) -> None:
    """Measure every clip.

    Args:
        folder: Folder with a folder of clips for each sample count, 1 included.
        weights: Networks with a running mean.
        levels: Lengths of the history, which are sample counts of the clips.
    """
    networks = {name: load(name, precision="fp32") for name in weights}
    rows = [row for index in range(len(ClipDataset(folder / "spp01")))
            for signal in SIGNALS for row in measured(folder, index, signal, levels, networks)]  # fmt: skip
    document = {"weights": list(weights), "levels": list(levels), "rows": rows}
    print(tables(document)["ideal-history"])
    harness.publish(RESULT, document, digits=4, pages=PAGES, tables=tables)


def measured(
    folder: Path, index: int, signal: str, levels: tuple[int, ...], networks: dict[str, Denoiser]
) -> Iterator[dict]:
    """A row for every method and length of its history, of the last frame of a clip."""
    clips = {spp: ClipDataset(folder / f"spp{spp:02d}").load(index, signal=signal) for spp in (1, *levels)}
    exposure = display_exposure(torch.cat([frame.reference for frame in clips[1]]))

    def row(method: str, way: str, length: int, image: Tensor, frame: Frame) -> dict:
        psnr = psnr_corrected(image, frame.reference, exposure, reference_half=frame.reference_half)
        return {"clip": index, "signal": signal, "method": method, "way": way, "length": length, "psnr": psnr}

    oidn, one = Oidn().step, clips[1][-1]
    for length, frames in clips.items():
        many = frames[-1]
        yield row("oidn", "", length, oidn(many)[0], many)
        for name, network in networks.items():
            yield row(name, "first", length, network.step(many)[0], many)
            if length > 1:
                yield row(name, "ideal", length, ideal(network, one, many, length), many)
    for name, network in networks.items():
        *_, last = outputs(network.step, clips[1])
        yield row(name, "real", len(clips[1]), last.image, one)


def ideal(network: Denoiser, frame: Frame, many: Frame, length: int) -> Tensor:
    """The output on `frame` after length - 1 others that nothing moved between; `many` is the mean of all."""
    still = torch.zeros_like(frame.motion)
    frame = replace(frame, motion=still, motion_next=still)
    light, mean = (demodulate(f.radiance, f.albedo, f.depth) for f in (frame, many))
    before, albedo = (
        ((length * a - b) / (length - 1)).clamp(min=0) for a, b in ((mean, light), (many.albedo, frame.albedo))
    )
    image, lengths = network.step(many)[0], torch.full_like(frame.depth, length - 1.0)
    for _ in range(ROUNDS):
        history = History(image, still, frame.depth, frame.normal, lengths, before, albedo)
        image = network.step(frame, history)[0]
    return image


def tables(document: dict) -> dict[str, str]:
    """Section `ideal-history`: means over clips by length, indirect light and beauty."""
    rows = document["rows"]
    lengths = sorted({row["length"] for row in rows})
    lines = [f"| | {' | '.join(f'{n}' for n in lengths)} |", "|---" * (len(lengths) + 1) + "|"]

    def mean(method: str, way: str, length: int, signal: str) -> str:
        wanted = {"method": method, "way": way, "length": length, "signal": signal}
        found = [row["psnr"] for row in rows if all(row[key] == value for key, value in wanted.items())]
        return f"{np.mean(found):.2f}" if found else ""

    methods = [("oidn", "", "OIDN, frame of so many samples")]
    methods += [(name, way, f"`{name}`, {label}") for name in document["weights"] for way, label in WAYS.items()]
    for method, way, label in methods:
        cells = (", ".join(filter(None, (mean(method, way, n, signal) for signal in SIGNALS))) for n in lengths)
        lines.append(f"| {label} | {' | '.join(cells)} |")
    return {"ideal-history": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
