"""Histories on disk: safetensors, read and written as numpy arrays. Never pickle, which can run code."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ..errors import InputError
from ..files import write_atomically


def write_history(path: Path, fields: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write the fields of a history, none where there is none yet. Raises InputError where they cannot be written."""
    write_atomically(path, save(dict(fields), metadata=dict(metadata)))


def read_history(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """What `write_history` wrote: fields and metadata. Raises InputError where the file cannot be read."""
    try:
        with safe_open(path, framework="numpy") as file:
            return {key: file.get_tensor(key) for key in file.keys()}, file.metadata() or {}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError) as error:
        raise InputError(f"{path}: not a readable history ({error})") from None
