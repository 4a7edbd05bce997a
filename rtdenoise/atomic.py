"""Files that are there whole or not at all."""

from __future__ import annotations

import contextlib
import os
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
