"""Files that are complete or absent, locks, and JSON that every reader accepts."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import platform
import re
import secrets
import stat
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import BinaryIO

from .errors import InputError

try:
    import fcntl
except ImportError:  # Windows: two runs on one folder are not kept apart
    fcntl = None

UNFINISHED = re.compile(r"\.rtdenoise-(\d+)-([0-9a-f]{8})[0-9a-f]{8}\.\w+")  # process, machine, a random number
DAY = 86400.0  # seconds
LOCK = ".rtdenoise-lock"  # in an output folder, while a run writes to it
NO_LOCKS = errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP  # as on a network's disk that is mounted without
NO_LINKS = getattr(os, "O_NOFOLLOW", 0)  # flags that Windows lacks
NO_WAITING = getattr(os, "O_NONBLOCK", 0)


def fingerprint(path: Path) -> str:
    """Of what a file holds: 16 digits of its SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def stamp(path: Path) -> list[str | int]:
    """Name, size and time of a file: tells it, without reading it, from one that took its place."""
    its = path.stat()
    return [path.name, its.st_size, its.st_mtime_ns]


@contextlib.contextmanager
def replacing(path: Path, suffix: str = ".tmp") -> Iterator[Path]:
    """A fresh file name in the folder of `path`: the file that the block writes there becomes `path` as the block ends.

    A link at `path` is replaced, never followed. Nothing is left behind where the block raises; an OSError of the fresh
    file, or that names none, as of a full disk, names `path`.
    """
    temporary = path.with_name(f".rtdenoise-{os.getpid()}-{_machine()}{secrets.token_hex(4)}{suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise
    finally:
        with contextlib.suppress(OSError):  # after the renaming there is none
            temporary.unlink()


def in_order(stored: bytes) -> bytes:
    """A safetensors file whose metadata stand in alphabetical order: the library's own differs from run to run."""
    end = 8 + int.from_bytes(stored[:8], "little")
    header = json.loads(stored[8:end])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # tensors are aligned to 8 bytes
    return len(text).to_bytes(8, "little") + text + stored[end:]


def write_atomically(path: Path, content: bytes | memoryview, sync: bool = False) -> None:
    """Write a file that appears under its name only when it is complete; with `sync` also after a loss of power.

    Raises InputError where it cannot be written, as on a full disk.
    """
    try:
        with replacing(path) as temporary:
            temporary.write_bytes(content)
            if sync:
                with open(temporary, "rb+") as file:  # Windows syncs no file that is open for reading
                    os.fsync(file.fileno())
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; run again when that is solved") from None


def remove_unfinished(folder: Path, inside: bool = False) -> None:
    """Remove the files that killed processes of this program were writing, with `inside` in inner folders too, but not
    beyond links. Call it while holding the folder's lock.

    Only processes of this machine can be checked for life. Files from other machines, which may write there too, are
    removed when they are a day old.
    """
    walk = os.walk(folder) if inside else [next(os.walk(folder), (folder, [], []))]
    for path in (Path(place) / name for place, _, names in walk for name in names):
        match = UNFINISHED.fullmatch(path.name)
        if not match:
            continue
        with contextlib.suppress(FileNotFoundError):
            found, here = path.lstat(), match[2] == _machine()
            dead = not _runs(int(match[1])) if here else time.time() - found.st_mtime > DAY
            if stat.S_ISREG(found.st_mode) and dead:
                path.unlink()


def _machine() -> str:
    """A name for this machine, to tell apart the machines that write to one folder."""
    return hashlib.sha256(platform.node().encode()).hexdigest()[:8]


def _runs(process: int) -> bool:
    """Whether another process has this number. If it is ours, a killed process had it before, as in a container."""
    if process == os.getpid():
        return False
    if os.name == "nt":  # there os.kill ends the process
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # it belongs to somebody else
        return True
    return True


@contextlib.contextmanager
def lock(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Hold a lock on a folder; the system releases it however the process ends.

    Raises InputError where another process holds it, and where the file `name` in the folder cannot be opened or is a
    link. Where the system or the file system has no locks nothing is held.
    """
    path = folder / name
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | NO_LINKS | NO_WAITING, 0o666)
    except OSError as error:
        raise InputError(f"{path}: cannot be opened: {error.strerror}; remove it or choose another --out") from None
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise InputError(f"{path}: not a regular file; remove it or choose another --out")
        if fcntl is not None:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    f"{folder}: another run is writing there; wait for it, or choose another --out"
                ) from None
            except OSError as error:
                if error.errno not in NO_LOCKS:
                    raise InputError(f"{path}: cannot be locked: {error.strerror}") from None
        yield
    finally:
        os.close(descriptor)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading. Raises InputError for a missing or unreadable file, a folder, a FIFO or a
    device: reading one of the last two could wait for ever."""
    try:
        file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | NO_WAITING))  # noqa: SIM115
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise InputError(f"{path}: cannot be read: {getattr(error, 'strerror', error)}") from None
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise InputError(f"{path}: cannot be read: not a regular file")
    return file


def read_bytes(path: Path) -> bytes:
    """The content of a regular file. Raises InputError where it cannot be read."""
    with open_regular(path) as file:
        try:
            return file.read()
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def read_text(path: Path) -> str:
    """The content of a regular UTF-8 file. Raises InputError where it cannot be read."""
    try:
        return read_bytes(path).decode()
    except UnicodeDecodeError:
        raise InputError(f"{path}: cannot be read: not a text file") from None


def utf8(text: str) -> bytes:
    """The text in UTF-8; what that lacks, as in names of files that are no text, becomes an escape."""
    return text.encode(errors="backslashreplace")


def read_json(path: Path) -> object:
    """The value in a JSON file. Raises InputError where it cannot be read or is not JSON; NaN and Infinity are not."""
    try:
        return json.loads(read_text(path), parse_constant=_refuse_constant)
    except RecursionError:
        raise InputError(f"{path}: not valid JSON: nested too deeply") from None
    except ValueError as error:
        raise error if isinstance(error, InputError) else InputError(f"{path}: not valid JSON: {error}") from None


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is not a JSON number")


def dumps(value: object, digits: int | None = None, **options) -> str:
    """`json.dumps`, with null for numbers that are not finite, the others rounded to `digits` significant digits."""
    return json.dumps(_plain(value, digits), allow_nan=False, **options)


def _plain(value: object, digits: int | None) -> object:
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    if isinstance(value, Mapping):
        return {key: _plain(item, digits) for key, item in value.items()}
    return [_plain(item, digits) for item in value] if isinstance(value, list | tuple) else value
