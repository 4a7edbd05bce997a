"""Pictures that the offline mode has combined, and that wait for those of the frames beside them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..data.stored import read_history, write_history
from ..errors import InputError
from ..frame import Frame

if TYPE_CHECKING:
    from torch import Tensor

BYTES_PER_PIXEL = 24  # of a file
FIELDS = {"radiance": "image", "spread": "spread", "trusted": "before", "trusted_after": "after"}  # of a file


@dataclass(frozen=True)
class Combined:
    """A frame's picture by itself, and what is known of its neighbours in time."""

    image: Tensor  # [1, 3, H, W] linear radiance, not negative
    spread: Tensor  # [1, 1, H, W] `combination.Combination`
    before: Tensor  # [1, 1, H, W] in [0, 1]: how far the forward pass trusted the picture before; 0: there is none
    after: Tensor  # [1, 1, H, W] likewise the backward pass the one after


@dataclass(frozen=True)
class Beside:
    """A frame beside another in its shot."""

    frame: Frame  # prepared
    image: Tensor  # [1, 3, H, W] its combined picture; each frame is divided by its own brightness


def write_combined(path: Path, found: Combined) -> None:
    """Store it. Raises InputError where it cannot be written."""
    write_history(path, {name: getattr(found, field).cpu().numpy() for name, field in FIELDS.items()}, {})


def read_combined(path: Path, device: str, size: tuple[int, int]) -> Combined:
    """The inverse of `write_combined`, for a frame of this size (height, width). Raises InputError where the file
    cannot be read, or is not of this frame."""
    import torch

    arrays, _ = read_history(path)
    for name in FIELDS:
        if name not in arrays or (arrays[name].shape[2:], arrays[name].dtype) != (size, np.float32):
            raise InputError(f"{path}: damaged, {name} is not as it was written; pass --overwrite to start anew")
    return Combined(**{field: torch.from_numpy(arrays[name]).to(device) for name, field in FIELDS.items()})
