"""Compile C files with the machine's own compiler, once: the user's cache folder keeps the results."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import re
import shutil
import subprocess
import tempfile
from importlib import resources
from pathlib import Path

from torch import Tensor

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
THREADS = "-fopenmp"  # finds the OpenMP that torch has loaded: both share one pool of threads
WIDE_VECTORS = "-mprefer-vector-width=512"  # x86: by default compilers use half the width


@functools.cache
def library(name: str, **constants: int | float) -> ctypes.CDLL:
    """`native/<name>.c` with `constants` defined, compiled and loaded. Floats become float32 literals.

    Raises OSError where there is no compiler or it fails; the message holds the compiler's first error.
    """
    folder = resources.files(__package__)
    source = (folder / f"{name}.c").read_text(encoding="utf-8")
    source = re.sub(r'#include "(.+)"\n', lambda file: (folder / file[1]).read_text(encoding="utf-8"), source)
    command = [_compiler(), *FLAGS, THREADS, *([WIDE_VECTORS] if platform.machine() in ("x86_64", "AMD64") else [])]
    command += [f"-D{key}={_literal(value)}" for key, value in sorted(constants.items())]
    key = hashlib.sha256("\0".join([source, *command, _machine()]).encode()).hexdigest()[:16]
    path = _cache() / f"{name}-{key}.so"
    if not path.is_file():
        _compile(command, source, path)
    return ctypes.CDLL(str(path))


def pointer(tensor: Tensor | None) -> ctypes.c_void_p:
    """The address of a tensor's first value; null for None."""
    return ctypes.c_void_p(tensor.data_ptr() if tensor is not None else None)


def _literal(value: int | float) -> str:
    return f"{value!r}f" if isinstance(value, float) else str(value)


def _compile(command: list[str], source: str, path: Path) -> None:
    """Compile to a temporary name, then rename, so that several processes may compile the same file at once."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        temporary = Path(folder) / path.name
        result = subprocess.run(
            [*command, "-x", "c", "-", "-o", str(temporary), "-lm"], input=source, capture_output=True, text=True
        )
        if result.returncode != 0:
            lines = result.stderr.splitlines() or [f"exit code {result.returncode}"]
            raise OSError(f"{command[0]} failed: {next((line for line in lines if 'error' in line), lines[0])}")
        temporary.replace(path)


def _compiler() -> str:
    """The path of `CC` where that is set and exists, else of the first of `COMPILERS` found."""
    for name in (os.environ.get("CC"), *COMPILERS):
        if name and (path := shutil.which(name)):
            return path
    raise OSError(f"no C compiler found (tried CC, {', '.join(COMPILERS)})")


def _cache() -> Path:
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rtdenoise"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _machine() -> str:
    """All that `-march=native` depends on: different machines may share a cache folder."""
    info = Path("/proc/cpuinfo")
    lines = set(info.read_text().splitlines()) if info.exists() else set()
    return "\0".join([platform.platform(), *sorted(s for s in lines if s.startswith(("flags", "model", "Features")))])
