"""Train the baseline `dc`, the Deep Combiner (Back et al. 2020): python bench/deep_combiner.py --data CLIPS ...

CLIPS are those of `combine_clips.py`, with denoised frames beside them (`rtdenoise estimates`). Loss as in the authors'
code: squared error over the squared mean of the reference's channels + 0.01. They train 50 epochs of Adam at 1e-4; the
rate here is higher for fewer steps, with a cosine to zero. Writes OUT/weights.safetensors, which `rtdenoise evaluate
--methods oidn+dc:FILE` and `bench/combine.py --combiners dc=FILE` take. Run again, it goes on where it stopped.
"""

from __future__ import annotations

import io
import math
import sys
from pathlib import Path
from pickle import UnpicklingError

sys.path.insert(0, str(Path(__file__).parents[1]))  # this checkout, whatever rtdenoise is installed
from bench import ROOT, harness

# isort: split
import torch
from torch import Tensor

from rtdenoise.baselines.deep_combiner import DeepCombiner
from rtdenoise.errors import InputError
from rtdenoise.files import write_atomically
from rtdenoise.training.batches import TrainingSet, windows
from rtdenoise.training.config import TrainConfig

EPSILON = 1e-2
WARMUP, KEEP = 50, 25  # steps: of the warm-up, between checkpoints


def main(
    data: tuple[Path, ...],
    out: Path = ROOT / "runs" / "dc",
    steps: int = 1500,
    batch: int = 4,
    size: int = 64,
    lr: float = 3e-4,
    softmax: bool = False,
    seed: int = 0,
) -> None:
    """Train.

    Args:
        data: Folders of training clips.
        out: Folder of the run.
        steps: Of the whole run.
        batch: Crops a step.
        size: Side of a crop in pixels.
        lr: Peak learning rate.
        softmax: Weights by softmax instead of ReLU over their sum.
        seed: Of weights and batches.
    """
    torch.manual_seed(seed)
    network = DeepCombiner(softmax)
    optimiser = torch.optim.Adam(network.parameters(), lr)
    options = TrainConfig(data, out, model="combiner", set=("evidence=false", "frames=1"), signal="both", frames=1,
                          batch=batch, size=size, steps=steps, seed=seed)  # fmt: skip
    asked = {"steps": steps, "batch": batch, "size": size, "lr": lr, "softmax": softmax, "seed": seed}
    clips, kept, first = TrainingSet.open(options), out / "checkpoint.pt", 0
    out.mkdir(parents=True, exist_ok=True)
    if kept.exists():
        try:
            first, weights, state, before = torch.load(kept, weights_only=True)
            changed = [name for name, value in asked.items() if before[name] != value]
            network.load_state_dict(weights)
            optimiser.load_state_dict(state)
        except (EOFError, LookupError, OSError, RuntimeError, TypeError, ValueError, UnpicklingError):
            raise InputError(f"{kept}: not a checkpoint of this script; remove it to begin anew") from None
        if changed:
            raise InputError(f"{out}: this run was started with {changed[0]} = {before[changed[0]]}, not "
                             f"{asked[changed[0]]}; use another --out")  # fmt: skip
    mean = None
    for step in range(first, steps):
        for group in optimiser.param_groups:
            group["lr"] = lr * min(1, (step + 1) / WARMUP) * (1 + math.cos(math.pi * step / steps)) / 2
        window = clips.batch(windows, options, step)
        frame, z = window.frames[0], window.estimates[0]
        error = relative_error(network.combine(window).image, frame.reference)
        optimiser.zero_grad()
        error.mean().backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        ratio = (error.detach().mean() / relative_error(z, frame.reference).mean().clamp(min=1e-9)).log().item()
        mean = ratio if mean is None else 0.95 * mean + 0.05 * ratio
        if (step + 1) % KEEP == 0 or step + 1 == steps:
            content = io.BytesIO()
            torch.save((step + 1, network.state_dict(), optimiser.state_dict(), asked), content)
            write_atomically(kept, content.getbuffer(), sync=True)
            print(f"step {step + 1}: error over z's {math.exp(mean):.3f}", flush=True)
    network.save(out / "weights.safetensors")


def relative_error(image: Tensor, reference: Tensor) -> Tensor:
    """relMSE of each image of a batch, `[B]`."""
    mean = reference.mean(1, keepdim=True)
    return ((image - reference).square() / (mean.square() + EPSILON)).mean((1, 2, 3))


if __name__ == "__main__":
    harness.run(main, __doc__)
