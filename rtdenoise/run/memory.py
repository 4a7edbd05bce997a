"""Reuse freed memory for the next frame; explain in one line when memory runs out."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Iterator
from contextlib import contextmanager

from ..errors import InputError

_MMAP_MAX, _TRIM_THRESHOLD, _ARENA_MAX = -4, -1, -8  # glibc's names M_MMAP_MAX and so on (mallopt(3))
_UNITS = {"bytes": 1 / 2**20, "KiB": 1 / 2**10, "MiB": 1.0, "GiB": 2.0**10, "TiB": 2.0**20}


def keep_freed() -> bool:
    """Have the C library keep freed memory for the next frame; returns whether it can do so (glibc only).

    By default it returns every large tensor to the system and requests it anew, page by page and zeroed: on a CPU that
    costs about as much as the arithmetic of a frame. The setting holds for the whole process: programs such as
    `rtdenoise denoise` make it, libraries should not. Memory in use stays at its peak. Threads share it.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library
        return False
    return all([mallopt(_MMAP_MAX, 0), mallopt(_TRIM_THRESHOLD, 2**31 - 1), mallopt(_ARENA_MAX, 1)])


@contextmanager
def explained(name: str, size: tuple[int, int], device: str) -> Iterator[None]:
    """Turn torch's out-of-memory errors in this block into an InputError with the amount and the remedy.

    `name` and `size` (H, W) are the frame's.
    """
    try:
        yield
    except RuntimeError as error:
        needed = re.search(r"tried to allocate ([\d.]+) (bytes|[KMGT]iB)", str(error), re.IGNORECASE)
        if needed is None:
            raise
        mib = float(needed[1]) * _UNITS[needed[2]]
        raise InputError(
            f"{name}: out of memory on {device} at {size[1]}×{size[0]}: {mib:.0f} MiB more were needed; "
            "use --precision bf16, another --device, or in a program rtdenoise.run.tiles.Tiled"
        ) from None
