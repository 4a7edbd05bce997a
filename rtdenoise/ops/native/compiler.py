"""Compile C files with the machine's own compiler, once: the user's cache folder keeps the results."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from ctypes import Array
from importlib import resources
from pathlib import Path

from torch import Tensor

from ...errors import NotCompiled
from . import cache

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
COMPILE_SECONDS = 15  # of all files that a model needs, on one core
THREADS = "-fopenmp"  # finds the OpenMP that torch has loaded: both share one pool of threads
PARALLEL = "void count(int *x, int n) {\n#pragma omp parallel for\nfor (int i = 0; i < n; i++) x[i] = i;\n}\n"
WIDE_VECTORS = "-mprefer-vector-width=512"  # x86: by default compilers use half the width


@functools.cache
def library(name: str, **constants: int | float) -> ctypes.CDLL:
    """`native/<name>.c` with `constants` defined, compiled and loaded. Floats become float32 literals.

    Raises NotCompiled where there is no compiler, it fails (the message holds its first error), or the cache folder
    cannot be used.
    """
    folder = resources.files(__package__)
    source = (folder / f"{name}.c").read_text(encoding="utf-8")
    source = re.sub(r'#include "(.+)"\n', lambda file: (folder / file[1]).read_text(encoding="utf-8"), source)
    wide = [WIDE_VECTORS] if platform.machine() in ("x86_64", "AMD64") else []
    defined = [f"-D{key}={_literal(value)}" for key, value in sorted(constants.items())]
    try:
        return _loaded(name, source, [*_threads(), *wide, *defined])
    except OSError as error:
        raise NotCompiled(f"{error.filename}: {error.strerror}" if error.filename else str(error)) from None


def _loaded(name: str, source: str, flags: Sequence[str]) -> ctypes.CDLL:
    """A source, compiled with these and the usual flags. Raises OSError where that or loading it fails."""
    command = [_compiler(), *FLAGS, *flags]
    key = hashlib.sha256("\0".join([source, *command, machine()]).encode()).hexdigest()[:16]
    source += f'\nconst char {cache.MARK}[] = "{key}";\n'
    return cache.load(name, key, lambda path: _compile(command, source, path))


@functools.cache
def _threads() -> tuple[str, ...]:
    """The flag that runs loops on torch's threads. Where the compiler knows no OpenMP, or not that of torch, as clang
    beside a torch of GCC's, there is none: they run on one thread, which is said. Raises OSError as `_loaded`."""
    try:
        _loaded("threads", PARALLEL, [THREADS])
    except OSError:
        _loaded("threads", PARALLEL, [])
        told = "rtdenoise: kernels run on one thread: %s does not share OpenMP with PyTorch; gcc does"
        logging.getLogger("rtdenoise").warning(told, _compiler())
        return ()
    return (THREADS,)


@functools.cache
def _announce() -> None:
    """Say once a process why the first frame takes long."""
    message = "rtdenoise: compiling kernels for this CPU once, about %d s; they are kept in %s"
    logging.getLogger("rtdenoise").warning(message, COMPILE_SECONDS, cache.folder())


def pointer(tensor: Tensor | None) -> ctypes.c_void_p:
    """The address of a tensor's first value; null for None. Raises RuntimeError for one that is not on the CPU."""
    return ctypes.c_void_p(None if tensor is None else _address(tensor))


def pointers(tensors: Iterable[Tensor]) -> Array[ctypes.c_void_p]:
    """`pointer` of each, as an array."""
    found = [_address(tensor) for tensor in tensors]
    return (ctypes.c_void_p * len(found))(*found)


def planes(images: Sequence[Tensor]) -> Array[ctypes.c_void_p]:
    """`pointers` to the planes of contiguous images, `[B, C, H, W]` each, joined along channels: B × ΣC."""
    return pointers(plane for parts in zip(*images, strict=True) for part in parts for plane in part)


def _address(tensor: Tensor) -> int:
    if not tensor.is_cpu:  # C would read memory that is not there
        raise RuntimeError(f"expected all tensors on the CPU, got one on {tensor.device}")
    return tensor.data_ptr()


def _literal(value: int | float) -> str:
    return f"{value!r}f" if isinstance(value, float) else str(value)


def _compile(command: list[str], source: str, path: Path) -> None:
    _announce()
    command = [*command, "-x", "c", "-", "-o", str(path), "-lm"]
    result = subprocess.run(command, input=source, capture_output=True, text=True, errors="replace")
    if result.returncode != 0:
        lines = result.stderr.splitlines() or [f"exit code {result.returncode}"]
        raise OSError(f"{command[0]} failed: {next((line for line in lines if 'error' in line), lines[0])}")


def _compiler() -> str:
    """The path of `CC` where that is set and exists, else of the first of `COMPILERS` found."""
    for name in (os.environ.get("CC"), *COMPILERS):
        if name and (path := shutil.which(name)):
            return path
    raise NotCompiled(f"no C compiler found (tried CC, {', '.join(COMPILERS)})")


def machine() -> str:
    """All that `-march=native` depends on: machines that share a home folder have different processors."""
    info = Path("/proc/cpuinfo")
    lines = set(info.read_text(encoding="utf-8").splitlines()) if info.exists() else set()
    return "\0".join([platform.platform(), *sorted(s for s in lines if s.startswith(("flags", "model", "Features")))])
