"""Histories on disk: safetensors, read and written as numpy arrays. Never pickle, which can run code."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..errors import InputError
from ..files import open_regular, write_atomically
from ..frame import HIDDEN

CHANNELS = {  # field of `History` -> channels; hidden features have any number of them, at any size
    "radiance": 3, "motion_next": 2, "depth": 1, "normal": 3, "length": 1, "mean": 3, "mean_albedo": 3,
    "residual": 3, "residual_length": 1,
}  # fmt: skip
LARGEST = 1e20  # no denoiser writes more, since radiance is at most 1e15; motion may be any finite number


def write_history(path: Path, fields: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write the fields of a history (none before the first frame). Raises InputError where they cannot be written."""
    write_atomically(path, save(dict(fields), metadata=dict(metadata)))


def read_history(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The fields `[B, C, H, W]` and metadata that `write_history` wrote.

    Raises InputError where the file cannot be read, for fields of another name, type or shape than those of a
    history, and for values that are not finite or beyond `LARGEST`.
    """
    open_regular(path).close()
    try:
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            fields = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, TypeError) as error:  # TypeError: a type that numpy lacks
        raise InputError(f"{path}: not a readable history ({error})") from None
    unknown = [name for name in fields if name not in CHANNELS and not re.fullmatch(rf"{HIDDEN}\d{{1,4}}", name)]
    if unknown or (fields and "radiance" not in fields):
        raise InputError(f"{path}: not a history of this version: it holds {', '.join(sorted(fields))}")
    for name, array in fields.items():
        _check(f"{path}: {name}", name, array, fields["radiance"].shape)
    return fields, metadata


def _check(label: str, name: str, array: np.ndarray, like: tuple[int, ...]) -> None:
    if array.dtype not in (np.float32, np.float16):
        raise InputError(f"{label} is {array.dtype}, expected float32")
    if name in CHANNELS:
        expected = (*like[:1], CHANNELS[name], *like[2:])
        fits = len(like) == 4 and array.shape == expected
    else:
        expected = (*like[:1], "C", "h", "w")
        fits = array.ndim == 4 and array.shape[0] == like[0]
    if not fits or not array.size:
        raise InputError(f"{label} is {array.shape}, expected {expected}")
    if not np.isfinite(array).all() or (name != "motion_next" and float(np.abs(array).max()) > LARGEST):
        raise InputError(f"{label} holds values that no denoiser writes (NaN, Inf or beyond {LARGEST:g})")
