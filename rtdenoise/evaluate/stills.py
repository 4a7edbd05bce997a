"""The pictures that an evaluation keeps: one frame of each sequence, by every method, with its reference."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from ..data.exr import write_layers
from ..frame import Frame
from .inputs import Source
from .measure import Result
from .sequence import uncovered


def stills(masks: list[torch.Tensor]) -> list[int]:
    """Indices of the frames to keep: the one with the largest uncovered share, else the last."""
    shares = [float(mask.float().mean()) for mask in masks]
    return [int(np.argmax(shares)) if max(shares) > 0 else len(masks) - 1]


def keep_picture(out: Path, source: Source, frames: list[Frame], method: str, result: Result) -> None:
    """Write the frames that `stills` names, as a method denoised them."""
    for i in stills(uncovered(frames)):
        write_layers(_still(out, source, frames[i]) / f"{method}.exr", {"color": _array(result.images[i])})


def keep_truth(out: Path, source: Source, frames: list[Frame]) -> None:
    """Write the references of the same frames, with motion and the uncovered pixels."""
    masks = uncovered(frames)
    for i in stills(masks):
        motion = torch.zeros_like(frames[i].radiance[:, :2]) if frames[i].motion is None else frames[i].motion
        truth = {"color": frames[i].reference, "motion": motion, "uncovered": masks[i].float()}
        layers = {layer: _array(image) for layer, image in truth.items()}
        write_layers(_still(out, source, frames[i]) / "reference.exr", layers)


def _still(out: Path, source: Source, frame: Frame) -> Path:
    folder = out / "pictures" / source.name / f"{frame.number:04d}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _array(image: torch.Tensor) -> np.ndarray:
    return image[0].permute(1, 2, 0).numpy()
