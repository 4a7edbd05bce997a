"""Compile one of the C files with the machine's own compiler, once: the result is kept in the user's cache folder. And
what it is called with."""

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
THREADS = "-fopenmp"  # finds the OpenMP that torch has loaded: one set of threads for both
WIDE = "-mprefer-vector-width=512"  # x86: compilers take half the width unless told


@functools.cache
def library(name: str, **constants: int) -> ctypes.CDLL:
    """`native/<name>.c` with `constants` defined, compiled and loaded.

    Raises OSError where there is no compiler, or it fails; the message is its first line.
    """
    folder = resources.files(__package__)
    source = (folder / f"{name}.c").read_text(encoding="utf-8")
    source = re.sub(r'#include "(.+)"\n', lambda file: (folder / file[1]).read_text(encoding="utf-8"), source)
    command = [_compiler(), *FLAGS, THREADS, *([WIDE] if platform.machine() in ("x86_64", "AMD64") else [])]
    command += [f"-D{key}={value}" for key, value in sorted(constants.items())]
    key = hashlib.sha256("\0".join([source, *command, _machine()]).encode()).hexdigest()[:16]
    path = _cache() / f"{name}-{key}.so"
    if not path.is_file():
        _compile(command, source, path)
    return ctypes.CDLL(str(path))


@functools.cache
def problem(name: str, **constants: int) -> str | None:
    """Why `library` cannot make this one (an old compiler without 16-bit floats, say), or None."""
    try:
        library(name, **constants)
    except OSError as error:
        return str(error)
    return None


def pointer(tensor: Tensor | None) -> ctypes.c_void_p:
    """To a tensor's first value, as the C functions take it; null for None."""
    return ctypes.c_void_p(tensor.data_ptr() if tensor is not None else None)


def _compile(command: list[str], source: str, path: Path) -> None:
    """Written under a temporary name first: processes that compile the same at once do not disturb each other."""
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
    """`CC` where it is set, else the first that is found."""
    for name in (os.environ.get("CC"), *COMPILERS):
        if name and (path := shutil.which(name)):
            return path
    raise OSError(f"no C compiler found ({', '.join(COMPILERS)}, or what CC names)")


def _cache() -> Path:
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "rtdenoise"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _machine() -> str:
    """What `-march=native` depends on: a cache folder may be shared by unlike machines."""
    info = Path("/proc/cpuinfo")
    lines = set(info.read_text().splitlines()) if info.exists() else set()
    return "\0".join([platform.platform(), *sorted(s for s in lines if s.startswith(("flags", "model", "Features")))])
