"""Estimates of the offline mode's first pass on disk, in half precision."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..data.stored import read_history, write_history
from ..errors import InputError
from ..wording import size_of
from . import combined

if TYPE_CHECKING:
    from .sides import Estimate

LARGEST_HALF = 2.0**14  # light is stored as float16 with its maximum below twice this
STORED = {"radiance": "image"}  # in a file -> field
STORED |= {name: name for name in ("footprint", "footprint_count", "surface_count", "trusted")}
LIGHT = ("radiance", "footprint")  # the first three channels of each
BYTES_PER_PIXEL = 30  # 15 halves


def check_disk(out: Path, frames: int, size: tuple[int, int]) -> None:
    """Raise InputError where the estimates of so many frames of a size (height, width) do not fit into a folder."""
    most = BYTES_PER_PIXEL * frames + combined.BYTES_PER_PIXEL  # that of a frame comes before its estimate goes
    needed, free = most * size[0] * size[1], shutil.disk_usage(out).free
    if needed > free:
        raise InputError(f"{out}: --offline keeps {size_of(needed)} there while it runs, {size_of(free)} are free; "
                         "choose another --out or fewer frames at a time")  # fmt: skip


def write_estimate(path: Path, estimate: Estimate) -> None:
    """Store an estimate in half precision. Raises InputError where it cannot be written."""
    arrays, scales = {}, {}
    for name, field in STORED.items():
        array = getattr(estimate, field).cpu().numpy()
        if name in LIGHT:
            light, rest = np.split(array, [3], axis=1)
            scales[name] = 2.0 ** np.floor(np.log2(max(float(light.max()), 1e-30) / LARGEST_HALF))
            array = np.concatenate([light / np.float32(scales[name]), rest], axis=1)
        arrays[name] = array.astype(np.float16)
    write_history(path, arrays, {"scales": json.dumps(scales), "first": str(int(estimate.first))})


def read_estimate(path: Path, device: str, size: tuple[int, int]) -> Estimate:
    """The inverse of `write_estimate`, for a frame of this size (height, width). Raises InputError where the file
    cannot be read, or is not of this frame."""
    import torch

    from .sides import Estimate

    arrays, metadata = read_history(path)
    try:
        if found := [array.shape for array in arrays.values() if array.shape[2:] != size]:
            raise ValueError(f"{found[0]}, expected {size[1]}×{size[0]} pixels")
        scales = {name: float(value) for name, value in json.loads(metadata["scales"]).items()}
        tensors = {}
        for name, field in STORED.items():
            tensors[field] = torch.from_numpy(arrays[name].astype(np.float32)).to(device)
            tensors[field][:, :3] *= scales.get(name, 1.0)
        return Estimate(**tensors, first=metadata["first"] == "1")
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: damaged, not as the first pass wrote it ({error}); pass --overwrite to start "
                         "anew") from None  # fmt: skip
