"""The pictures that an evaluation keeps: one frame of each sequence, by every method, with its reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ..data.exr import write_layers
from ..frame import Frame
from .inputs import Source
from .sequence import uncovered


def stills(masks: list[torch.Tensor]) -> list[int]:
    """Indices of the frames to keep: the one with the largest uncovered share, else the last."""
    shares = [float(mask.float().mean()) for mask in masks]
    return [int(np.argmax(shares)) if max(shares) > 0 else len(masks) - 1]


def keep_picture(out: Path, source: Source, number: int, method: str, image: torch.Tensor) -> None:
    """Write a frame as a method denoised it."""
    write_layers(_still(out, source, number) / f"{method}.exr", {"color": _array(image)})


def keep_truth(out: Path, source: Source, frames: Sequence[Frame]) -> None:
    """Write the reference of the last of one or two frames, with its motion and the uncovered pixels."""
    frame, mask = frames[-1], uncovered(frames)[-1]
    motion = torch.zeros_like(frame.radiance[:, :2]) if frame.motion is None else frame.motion
    truth = {"color": frame.reference, "motion": motion, "uncovered": mask.float()}
    layers = {layer: _array(image) for layer, image in truth.items()}
    write_layers(_still(out, source, frame.number) / "reference.exr", layers)


def _still(out: Path, source: Source, number: int) -> Path:
    folder = out / "pictures" / source.name / f"{number:04d}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _array(image: torch.Tensor) -> np.ndarray:
    return image[0].permute(1, 2, 0).numpy()
