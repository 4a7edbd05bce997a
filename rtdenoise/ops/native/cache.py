"""The user's cache folder for compiled code. A loaded file runs, so a file is loaded only if it is whole and nobody
else can have written it.

A file is called NAME-KEY-CHECKSUM.so: KEY is a hash of all that decides the code, CHECKSUM of the file's content. It
appears under that name when it is complete and on the disk. A damaged file is removed and compiled again.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import secrets
import stat
import threading
from collections.abc import Callable
from pathlib import Path

WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
MARK = "rtdenoise_key"  # a symbol of every library: its key
_loading = threading.Lock()


def folder() -> Path:
    """`rtdenoise` in `XDG_CACHE_HOME` or `~/.cache`, made if need be. Raises OSError where it is not safe to use."""
    path = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rtdenoise"
    path.mkdir(parents=True, exist_ok=True, mode=0o700)
    _refuse_others(path, os.stat(path))
    return path


def load(name: str, key: str, build: Callable[[Path], None]) -> ctypes.CDLL:
    """The library `name` of this key: the one in the folder, else `build(path)` writes it, once for all threads.

    Raises OSError where the folder is not safe, cannot be written, or the library cannot be loaded.
    """
    place = folder()
    with _loading:
        for path in sorted(place.glob(f"{name}-{key}-*.so")):
            if (found := _opened(path, key)) is not None:
                return found
            path.unlink(missing_ok=True)
        path = _built(place, name, key, build)
        if (found := _opened(path, key)) is None:
            raise OSError(f"{path}: cannot be loaded")
        return found


def _built(place: Path, name: str, key: str, build: Callable[[Path], None]) -> Path:
    """Write, sync, rename: other processes, and this one after a crash, see the whole file or none."""
    temporary = place / f".{name}-{os.getpid()}-{secrets.token_hex(8)}.so"
    try:
        build(temporary)
        with open(temporary, "rb+") as file:  # Windows syncs no file that is open for reading
            checksum = _checksum(file.read())
            os.fsync(file.fileno())
        os.chmod(temporary, 0o700)
        path = place / f"{name}-{key}-{checksum}.so"
        temporary.replace(path)
        return path
    finally:
        with contextlib.suppress(OSError):  # after the renaming there is none
            temporary.unlink()


def _opened(path: Path, key: str) -> ctypes.CDLL | None:
    """The library in a file; None where the file is damaged or holds something else.

    The content is compared before the file is mapped: reading beyond the end of a truncated one kills the process.
    """
    try:
        with open(path, "rb", opener=lambda p, flags: os.open(p, flags | getattr(os, "O_NOFOLLOW", 0))) as file:
            _refuse_others(path, os.fstat(file.fileno()))
            if path.stem.rpartition("-")[2] != _checksum(file.read()):
                return None
        found = ctypes.CDLL(str(path))
        return found if (ctypes.c_char * len(key)).in_dll(found, MARK).raw == key.encode() else None
    except (OSError, ValueError) as error:  # ValueError: no such symbol
        if isinstance(error, PermissionError):
            raise
        return None


def _refuse_others(path: Path, found: os.stat_result) -> None:
    """Raise PermissionError unless the file or folder is ours (or root's) and nobody else may write to it."""
    if not hasattr(os, "getuid"):  # Windows keeps the profile's folders to their owner
        return
    if found.st_uid not in (os.getuid(), 0):
        raise PermissionError(f"{path}: belongs to another user, so its code is not run; set XDG_CACHE_HOME to a "
                              "folder of your own")  # fmt: skip
    if found.st_mode & WRITABLE_BY_OTHERS:
        raise PermissionError(f"{path}: others may write to it, so its code is not run; chmod go-w it")


def _checksum(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]
