"""Which OpenGL context is current: a program's own one stays so round every call of ours."""

from __future__ import annotations

import ctypes
import functools
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import moderngl

from ..errors import InputError

DRAW, READ = 0x3059, 0x305A  # EGL_DRAW, EGL_READ
_HANDLE = "rtdenoise_handle"  # attribute of a context: EGL's, 0 where it is not EGL's
_processes: set[int] = set()  # that which uses OpenGL, and in its forks that from which they come


@contextmanager
def current(ctx: moderngl.Context) -> Iterator[None]:
    """Make a context current in this thread. Afterwards the one before is current again, if it is EGL's. Where there
    was none, this one stays.

    Raises InputError where another thread has the context, and as `refuse_fork`.
    """
    refuse_fork()
    with restored():
        before, known = _handle(), vars(ctx).get(_HANDLE)
        if not known or before != known:
            ctx.__enter__()
            if _handle() != vars(ctx).setdefault(_HANDLE, _handle()):
                raise InputError("this OpenGL context cannot be current here: shaders run in the thread that made "
                                 "them, and beside no context of GLX; make another Denoiser or Pipeline")  # fmt: skip
        ctx.gc()  # what has been dropped meanwhile, perhaps under another context
        yield


def refuse_fork() -> None:
    """Raise InputError in a fork of a process that had begun to use OpenGL: drivers wait there for ever."""
    _processes.add(os.getpid())
    if len(_processes) > 1:
        raise InputError("shaders cannot run in a fork of a process that uses OpenGL; start processes anew, as by "
                         "multiprocessing.get_context('spawn')")  # fmt: skip


@contextmanager
def restored() -> Iterator[None]:
    """Afterwards the context that is current now is so again, if it is EGL's."""
    egl, before = _egl(), _handle()
    drawing = before and (egl.eglGetCurrentDisplay(), egl.eglGetCurrentSurface(DRAW), egl.eglGetCurrentSurface(READ))
    try:
        yield
    finally:
        if drawing and _handle() != before:
            egl.eglMakeCurrent(*drawing, before)


def remember_handle(ctx: moderngl.Context) -> None:
    """Note which of EGL's contexts it is. Call it while the context is current."""
    vars(ctx)[_HANDLE] = _handle()


def _handle() -> int:
    """EGL's current context; 0: none."""
    return (_egl() and _egl().eglGetCurrentContext()) or 0


@functools.cache
def _egl() -> ctypes.CDLL | None:
    """EGL, on Linux where it is installed."""
    try:
        egl = ctypes.CDLL("libEGL.so.1") if sys.platform.startswith("linux") else None
    except OSError:
        egl = None
    if egl is not None:
        for name in ("eglGetCurrentContext", "eglGetCurrentDisplay", "eglGetCurrentSurface"):
            getattr(egl, name).restype = ctypes.c_void_p
        egl.eglMakeCurrent.argtypes = (ctypes.c_void_p,) * 4
    return egl
