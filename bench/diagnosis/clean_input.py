"""Does a network leave light alone that has no noise? What stands in the way: its kernels, its edge kernel?

python bench/diagnosis/clean_input.py CLIPS ... [--weights default many]

First frames of clips whose references have hundreds of samples: one half of the reference takes the place of the noisy
frame, the other half judges. A denoiser that knows noise from light returns the frame. PSNR is corrected for the noise
of the judging half and, below OIDN and the weights, also shown for the weights with their edge kernel taken out, with
the finest spatial kernel on the pixel alone, and with both. Mean weights of a pixel in its own kernels stand beside it.
Writes bench/results/clean_input.json and the table of docs/notes/clean_input.md.
"""

from __future__ import annotations

import sys
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
from rtdenoise.frame import Frame
from rtdenoise.metrics.image import decibels, mse, reference_mse
from rtdenoise.models import load
from rtdenoise.models.accumulated_kpn import AccumulatedKPN, Heads
from rtdenoise.ops.even_sky import even_sky
from rtdenoise.ops.pixels import demodulate, modulate

RESULT, PAGES = RESULTS / "clean_input.json", (DOCS / "notes" / "clean_input.md",)
SIGNALS = ("indirect", "color")
VARIANTS = {"": "as it is", "-edge": "no edge kernel", "-finest": "finest kernel: the pixel", "-both": "both"}
LEAST = 1e-7  # squared error that a logarithm is taken of
ALONE = 30.0  # logit of a kernel's middle: all its weight


def main(folders: tyro.conf.Positional[tuple[Path, ...]], weights: tuple[str, ...] = ("default", "many")) -> None:
    networks = {name: load(name, precision="fp32") for name in weights}
    rows = []
    for folder in folders:
        clips = ClipDataset(folder)
        for index in range(len(clips)):
            for signal in SIGNALS:
                frame = clips.load(index, signal=signal)[0]
                rows.append({"clips": folder.parent.name, "clip": index, "signal": signal, **measured(frame, networks)})
                print(rows[-1], flush=True)
    harness.publish(RESULT, {"weights": list(weights), "rows": rows}, digits=4, pages=PAGES, tables=tables)


@torch.inference_mode()
def measured(frame: Frame, networks: dict[str, AccumulatedKPN]) -> dict[str, float]:
    """PSNR of each method without noise; NAME-centre, NAME-edge-centre -> mean weight of a pixel in its kernels."""
    scale, judge = display_exposure(frame.reference), 2 * frame.reference - frame.reference_half
    noise = 2 * reference_mse(frame.reference, frame.reference_half, scale)  # of half of the samples
    frame = replace(frame, radiance=frame.reference_half)

    def psnr(image: Tensor) -> float:
        return decibels(max(LEAST, mse(image, judge, scale) - noise))

    found = {"oidn": psnr(Oidn().step(frame)[0])}
    for name, network in networks.items():
        heads = network.step_and_kernels(frame)[2].heads
        finest = replace(heads, spatial=[_alone(heads.spatial[0]), *heads.spatial[1:]])
        changed = {
            "": heads,
            "-edge": replace(heads, edge=None),
            "-finest": finest,
            "-both": replace(finest, edge=None),
        }
        found |= {name + key: psnr(filtered(network, frame, other)) for key, other in changed.items()}
        found[f"{name}-centre"], found[f"{name}-edge-centre"] = _middle(heads.spatial[0]), _middle(heads.edge)
    return found


def filtered(network: AccumulatedKPN, frame: Frame, heads: Heads) -> Tensor:
    """A first frame as `AccumulatedKPN.step` filters it, by `heads`."""
    light = network.over_space(demodulate(frame.radiance, frame.albedo, frame.depth), heads)
    image = modulate(light, frame.albedo, frame.albedo, heads.sharp, frame.depth)
    never = torch.zeros_like(frame.depth, dtype=torch.bool)
    image = network.over_edges_and_time(image, frame.radiance, never, heads)
    return even_sky(image, frame.radiance, frame.depth)


def _alone(logits: Tensor) -> Tensor:
    """Kernels by cells `[B, 2, 2, K², H/2, W/2]` whose weight is all in the middle."""
    changed = torch.full_like(logits, -ALONE)
    changed[:, :, :, logits.shape[3] // 2] = ALONE
    return changed


def _middle(logits: Tensor) -> float:
    return float(logits.float().softmax(3)[:, :, :, logits.shape[3] // 2].mean())


def tables(document: dict) -> dict[str, str]:
    """Section `clean-input`: means over clips, indirect light and beauty."""
    sets = list(dict.fromkeys(row["clips"] for row in document["rows"]))
    lines = [
        f"| | {' | '.join(sets)} | own weight, finest kernel | own weight, edge kernel |",
        "|---" * (len(sets) + 3) + "|",
    ]

    def mean(key: str, clips: str | None = None, signal: str | None = None) -> float:
        wanted = {"clips": clips, "signal": signal}
        rows = [r for r in document["rows"] if all(value in (None, r[k]) for k, value in wanted.items())]
        return float(np.mean([row[key] for row in rows]))

    def line(label: str, key: str, own: str) -> str:
        cells = [", ".join(f"{mean(key, clips, signal):.2f}" for signal in SIGNALS) for clips in sets]
        return f"| {label} | {' | '.join(cells)} | {own} |"

    lines.append(line("OIDN", "oidn", " | "))
    for name in document["weights"]:
        own = f"{mean(f'{name}-centre'):.2f} | {mean(f'{name}-edge-centre'):.2f}"
        for key, what in VARIANTS.items():
            lines.append(line(f"`{name}`, {what}", name + key, " | " if key else own))
    return {"clean-input": "\n".join(lines)}


if __name__ == "__main__":
    harness.run(main, __doc__)
