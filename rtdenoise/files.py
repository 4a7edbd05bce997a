"""Files that are there whole or not at all, and JSON that every reader takes."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path

from .errors import InputError


def write_atomically(path: Path, content: bytes | memoryview) -> None:
    """The file appears under its name only when it is complete: it is renamed, in its folder, once it is written.

    Raises InputError where it cannot be written, as on a full disk; nothing is left behind then.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; run again when that is solved") from None
    finally:
        with contextlib.suppress(OSError):  # it is gone after the renaming
            temporary.unlink()


def dumps(value: object, digits: int | None = None, **options) -> str:
    """`json.dumps`, with null for numbers that are not finite, and the others rounded to so many significant digits."""
    return json.dumps(_plain(value, digits), allow_nan=False, **options)


def _plain(value: object, digits: int | None) -> object:
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    if isinstance(value, Mapping):
        return {key: _plain(item, digits) for key, item in value.items()}
    return [_plain(item, digits) for item in value] if isinstance(value, list | tuple) else value
