"""Histories on disk: safetensors, read and written as numpy arrays. Never pickle, which can run code."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..constants import RECALL_FOOTPRINT_WORDS, RECALL_RESET, RECALL_WORDS, SHIFT_CELL
from ..errors import InputError
from ..files import open_regular, write_atomically
from ..frame import HIDDEN, RECENT, SHIFTS

CHANNELS = {  # field of `History` -> channels; hidden features have any number of them, at any size
    "radiance": 3, "motion_next": 2, "depth": 1, "normal": 3, "length": 1, "mean": 3, "mean_albedo": 3,
    "noisy": 3, "residual": 3, "residual_length": 1, "footprint": 9, "footprint_count": 1, "trusted": 1,
}  # fmt: skip
OF = "/"  # between the number of a light and the field of its history (`run.light`)
FOUND = "found"  # the field of shifts, of cells of pixels as `SHIFTS`
OF_ESTIMATES = {"surface_count": 1, "spread": 1, "trusted_after": 1}  # of the offline mode's files, not of a history
BRIGHTNESS, GAINS = "brightness", "gains"  # in the state of a run: `run.following.Followed`
SEEN = 60_000  # about so many pixels of a frame are compared there
RESETS = "resets"  # in the place of recent frames, in the state of a run: [1, frames, H, W] int16, bits of bfloat16
OF_MOTION = 8, 9, 13, 14  # channels of a kept frame (`ops.recall`) that may be any finite number
LARGEST = 1e20  # no denoiser writes more, since radiance is at most 1e15; motion may be any finite number


def write_history(path: str | Path, fields: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write the fields of a history (none before the first frame). Raises InputError where they cannot be written."""
    write_atomically(Path(path), save(dict(fields), metadata=dict(metadata)))


def read_history(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
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
    one = "|".join({*CHANNELS, *OF_ESTIMATES, RESETS, FOUND, BRIGHTNESS, GAINS})
    known = re.compile(rf"(\d{{1,4}}{OF})?({one}|({HIDDEN}|{RECENT}|{SHIFTS})\d{{1,4}})")
    unknown = [name for name in fields if not known.fullmatch(name)]
    if unknown or (fields and "radiance" not in fields):
        raise InputError(f"{path}: not a history of this version: it holds {', '.join(sorted(fields))}")
    for name, array in fields.items():
        _check(f"{path}: {name}", name.rpartition(OF)[2], array, fields["radiance"].shape)
    return fields, metadata


def of_resets(words: Iterable[np.ndarray]) -> dict[str, np.ndarray]:
    """The field `resets`, of those words of recent frames that hold them, `[1, 1, H, W]` each; none without frames."""
    words = list(words)
    return {RESETS: np.concatenate([w.view(np.int32) >> 16 for w in words], 1).astype(np.int16)} if words else {}


def with_resets(fields: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Fields with recent frames that hold their resets and nothing else, in the place of `resets`."""
    fields = dict(fields)
    for i, bits in enumerate(np.moveaxis(fields.pop(RESETS, np.zeros((1, 0, 1, 1), np.int16)), 1, 0)):
        fields[f"{RECENT}{i}"] = words = np.zeros((1, RECALL_WORDS, *bits.shape[1:]), np.int32)
        words[:, RECALL_RESET] = bits.astype(np.int32) << 16
    return fields


def seen_step(size: tuple[int, ...]) -> int:
    """Of so many pixels of a row, and so many rows, `brightness` compares one in frames of this size (H, W)."""
    return max(1, round(math.sqrt(math.prod(size) / SEEN)))


def _check(label: str, name: str, array: np.ndarray, like: tuple[int, ...]) -> None:
    recent, resets = name.startswith(RECENT), name == RESETS
    expected_type = np.int32 if recent else np.int16 if resets else np.float32
    if array.dtype != expected_type and (array.dtype, expected_type) != (np.float16, np.float32):
        raise InputError(f"{label} is {array.dtype}, expected {expected_type.__name__}")
    channels = (CHANNELS | OF_ESTIMATES).get(name)
    if recent:
        words = array.shape[1] if array.ndim == 4 else 0
        channels = words if words == RECALL_FOOTPRINT_WORDS else RECALL_WORDS
    size = like[2:]
    if name == FOUND or name.startswith(SHIFTS):
        channels, size = 2, tuple(-(-n // SHIFT_CELL) for n in size)
    if name == BRIGHTNESS:
        channels, size = 9, tuple(-(-n // seen_step(size)) for n in size)
    if name == GAINS:
        channels, size = array.size, (1, 1)
    if channels is not None:
        expected = (*like[:1], channels, *size)
        fits = len(like) == 4 and array.shape == expected
    else:
        expected = (*like[:1], "C", "h", "w")
        fits = array.ndim == 4 and array.shape[0] == like[0] and (not resets or array.shape[2:] == like[2:])
    if not fits or not array.size:
        raise InputError(f"{label} is {array.shape}, expected {expected}")
    if recent:
        array = np.stack([array << 16, array & -65536], axis=2).view(np.float32)  # [B, words, 2, H, W]
        array = array.reshape(len(array), 2 * words, *size)
        array = np.delete(array, [c for c in OF_MOTION if c < 2 * words], axis=1)
    if resets:
        array = (array.astype(np.int32) << 16).view(np.float32)
    if name == GAINS and not (array > 0).all():
        raise InputError(f"{label} holds gains that are not positive")
    if not np.isfinite(array).all() or (name != "motion_next" and float(np.abs(array).max()) > LARGEST):
        raise InputError(f"{label} holds values that no denoiser writes (NaN, Inf or beyond {LARGEST:g})")
