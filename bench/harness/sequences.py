"""Frames to measure on, and a denoiser run over them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from rtdenoise.data.clips import ClipDataset
from rtdenoise.data.opening import open_sequence
from rtdenoise.evaluate import Step, evaluate, outputs
from rtdenoise.frame import Frame

from .. import SAMPLE


def mural(signal: str, layers: tuple[str, ...] | None = None) -> list[Frame]:
    """All frames of the bundled sequence, with these layers beside the ones that a denoiser needs."""
    return list(open_sequence(SAMPLE, signal=signal, layers=layers))


def clips(folder: Path, count: int, signal: str) -> Iterator[list[Frame]]:
    """At most `count` clips of a folder, evenly spaced."""
    data = ClipDataset(folder)
    for index in np.linspace(0, len(data) - 1, min(count, len(data))).astype(int):
        yield data.load(int(index), signal=signal)


@torch.inference_mode()
def denoise(step: Step, frames: Iterable[Frame]) -> list[Tensor]:
    """The images `[1, 3, H, W]` of a sequence, each from its frame and the history of the frames before."""
    return [output.image for output in outputs(step, frames)]


def mean_errors(
    step: Step, sequences: Iterable[list[Frame]], metrics: Sequence[str], regions: Sequence[str]
) -> dict[str, dict[str, float]]:
    """region -> metric -> mean over the sequences of the error that `evaluate` reports, without sequences in which the
    region is empty."""
    found = [evaluate(frames, {"it": step}, metrics=metrics, regions=regions)[0].errors for frames in sequences]
    return {r: {m: float(np.nanmean([errors[r][m] for errors in found])) for m in metrics} for r in regions}
