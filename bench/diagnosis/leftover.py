"""Is the noise that history leaves harder to filter than a renderer's of the same strength?

python bench/diagnosis/leftover.py SEQUENCE ...

SEQUENCE holds 1 sample a pixel, SEQUENCE/spp8 the same frames at 8 (docs/results/large.md renders both). The network of
`hybrid-large` that writes pixels gets what recent frames have seen in each pixel, as in a run; then the reference with
the error of the 8 samples instead, made as strong in 9×9 pixels around each; then the reference with its own error, of
which the sign of each pixel is drawn. Writes bench/results/leftover.json and the table of docs/notes/hybrid.md.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # this checkout, whatever rtdenoise is installed
from bench import DOCS, RESULTS, harness

# isort: split
import torch
import tyro
from torch import Tensor
from torch.nn import functional as F

from rtdenoise.color import display_exposure
from rtdenoise.constants import PIXELS_LIGHT
from rtdenoise.data.opening import open_sequence
from rtdenoise.evaluate.inputs import Source
from rtdenoise.frame import Frame
from rtdenoise.metrics.image import decibels, mse_corrected
from rtdenoise.models import load
from rtdenoise.models.hybrid_config import SURFACES
from rtdenoise.models.pixel_network import written
from rtdenoise.ops.lift import lower

RESULT, PAGES = RESULTS / "leftover.json", (DOCS / "notes" / "hybrid.md",)
MODEL, SAMPLES = "hybrid-large", 8
FIRST, FRAMES = 7, 11  # frames before the first are not counted: their histories are short
WINDOW = 9  # pixels, within which errors are made as strong
KINDS = {
    "input": "what recent frames have seen",
    "own": "filtered",
    "renderer": f"with the noise of {SAMPLES} samples, as strong",
    "signs": "with its own, signs drawn",
}


def main(sequences: tyro.conf.Positional[tuple[Path, ...]]) -> None:
    model, rows = load(MODEL, precision="fp32"), []
    for folder in sequences:
        for signal in ("indirect", "color"):
            source = Source.open(folder, signal, "auto", None)
            frames = source.frames(source.spp)[:FRAMES]
            more = list(open_sequence(folder / f"spp{SAMPLES}", signal=signal))
            rows.append({"sequence": source.name, "signal": signal} | measured(model, frames, more))
            print(rows[-1])
    harness.publish(RESULT, {"rows": rows}, pages=PAGES, tables=tables)


@torch.inference_mode()
def measured(model: torch.nn.Module, frames: list[Frame], more: list[Frame]) -> dict[str, float]:
    """One of KINDS -> corrected PSNR in dB."""
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    errors = {kind: [] for kind in KINDS}
    signs = torch.Generator().manual_seed(0)
    for i, (frame, seen, exposure, network) in enumerate(inputs(model, frames)):
        if i < FIRST:
            continue
        own, of_renderer = seen - frame.reference, more[i].radiance - frame.reference
        drawn = torch.randint(0, 2, own[:, :1].shape, generator=signs) * 2 - 1
        strength = (around(own) / (around(of_renderer) + 1e-12)).sqrt()
        shown = {"own": own, "renderer": strength * of_renderer, "signs": drawn * own}
        images = {kind: (frame.reference + error).clamp(min=0) for kind, error in shown.items()}
        images = {kind: written(network, image, image, exposure) for kind, image in images.items()}
        for kind, image in {"input": seen, **images}.items():
            errors[kind].append(mse_corrected(image, frame.reference, scale, reference_half=frame.reference_half))
    return {kind: decibels(sum(values) / len(values)) for kind, values in errors.items()}


def inputs(model: torch.nn.Module, frames: list[Frame]) -> Iterator[tuple]:
    """Each frame, the light that the network of pixels gets, the exposure, and the network with its other inputs."""
    given, history = deque(maxlen=1), None
    model.pixels.register_forward_pre_hook(lambda _, arguments: given.append(arguments))
    for frame in frames:
        exposure = model.statistics(frame)[0]
        _, history = model.step(frame, history)
        lit, *guides = given[0]
        network = partial(model.pixels.write, **dict(zip(SURFACES, model.pixels.clean(*guides), strict=True)))
        yield frame, lower(lit) / (PIXELS_LIGHT * exposure), exposure, network


def around(error: Tensor) -> Tensor:
    """Its mean square in the window around each pixel, `[B, 1, H, W]`."""
    square = F.pad(error.square().mean(1, keepdim=True), [WINDOW // 2] * 4, mode="replicate")
    return F.avg_pool2d(square, WINDOW, stride=1)


def tables(document: dict) -> dict[str, str]:
    """Section `leftover`: corrected PSNR in dB."""
    lines = [f"| | signal | {' | '.join(KINDS.values())} |", "|---" * (2 + len(KINDS)) + "|"]
    for row in document["rows"]:
        lines.append(f"| {row['sequence']} | {row['signal']} | {' | '.join(f'{row[kind]:.2f}' for kind in KINDS)} |")
    return {"leftover": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
