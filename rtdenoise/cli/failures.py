"""Errors that a user can cause, as one line each. Like `main`, this module imports almost nothing."""

from __future__ import annotations

from ..errors import INSTALL_TORCH, InputError, NotFused

OUT_OF_MEMORY = (  # how torch, its drivers and the system's loader say it
    "out of memory", "can't allocate memory", "not enough memory", "bad_alloc", "failed to map segment",
    "cannot allocate memory",
)  # fmt: skip


def line(error: Exception, advice: str = "") -> str | None:
    """What there is to tell of an error, with `advice` where memory ran out; None where it is a fault of the
    program."""
    if isinstance(error, InputError | NotFused):
        return str(error)
    if isinstance(error, ModuleNotFoundError):
        missing = (error.name or "").partition(".")[0] == "torch"
        return f"this needs PyTorch, which is not installed; {INSTALL_TORCH}" if missing else None
    if isinstance(error, MemoryError) or (isinstance(error, RuntimeError | ImportError) and _lacks_memory(error)):
        detail = str(error).partition("\n")[0]
        return f"out of memory{f' ({detail})' if detail else ''}{advice}"
    if isinstance(error, OSError):  # a full disk, a folder without write permission
        return f"{error.filename or 'a file'}: {error.strerror or error}"
    return None


def _lacks_memory(error: Exception) -> bool:
    return any(words in str(error).lower() for words in OUT_OF_MEMORY)
