"""The OpenGL context of the shaders, and arrays in its memory."""

from __future__ import annotations

import math
import sys
import threading
import weakref
from dataclasses import dataclass

import moderngl
import numpy as np

from ..errors import InputError
from .current import current, refuse_fork, remember_handle, restored

PACKAGES = "libegl1 libegl-mesa0 libgl1 libgl1-mesa-dri"  # Debian and Ubuntu; a vendor's own driver serves as well

_thread = threading.local()


class GpuMemoryError(InputError):
    """An array is larger than the device's memory, or than a shader may address."""


def create_context() -> moderngl.Context:
    """A context without a window: OpenGL 4.3 or later, through EGL on Linux. It belongs to the thread that creates it.
    Another context that is current there stays so, if it is EGL's.

    Raises InputError where there is no such driver, and as `current.refuse_fork`.
    """
    refuse_fork()
    backend = {"backend": "egl"} if sys.platform.startswith("linux") else {}
    with restored():
        try:
            ctx = moderngl.create_standalone_context(require=430, **backend)
        except Exception as error:  # glcontext raises bare `Exception`
            raise InputError(
                f"no OpenGL with compute shaders: expected 4.3 or later through EGL, found {_found(backend, error)}; "
                f"on Debian or Ubuntu type: apt install {PACKAGES}"
            ) from None
        remember_handle(ctx)
    ctx.gc_mode = "context_gc"  # buffers die with the Python objects that own them, when the context is next current
    weakref.finalize(ctx, ctx.mglo.release).atexit = False
    return ctx


def _found(backend: dict[str, str], error: Exception) -> str:
    """The driver's version, where it is older than OpenGL 4.3, or the reason why there is none."""
    try:
        older = moderngl.create_standalone_context(**backend)
    except Exception:
        return f"none ({error})"
    found = f"{older.version_code / 100:.1f} ({older.info['GL_RENDERER']})"
    older.release()
    return found


def default_context() -> moderngl.Context:
    """The context that operations on numpy arrays use: one per thread, created on first use."""
    if not hasattr(_thread, "ctx"):
        _thread.ctx = create_context()
    return _thread.ctx


def storage_limit(ctx: moderngl.Context) -> int:
    """Bytes of one buffer that a shader can address (128 MiB in Mesa's llvmpipe, 2 GiB and more on most GPUs)."""
    with current(ctx):
        return ctx.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]


@dataclass(frozen=True)
class GpuArray:
    """A C-contiguous array in a shader storage buffer.

    float16 is packed as numpy has it in memory: value i is the low (i even) or high (i odd) half of the 32-bit word
    ⌊i/2⌋. An odd count is padded to a whole word.
    """

    buffer: moderngl.Buffer
    shape: tuple[int, ...]
    dtype: np.dtype  # float32, float16 or uint32
    label: str = ""  # a name for people and for `record`

    @classmethod
    def empty(
        cls,
        ctx: moderngl.Context,
        shape: tuple[int, ...],
        dtype: np.typing.DTypeLike = np.float32,
        label: str = "",
    ) -> GpuArray:
        """An array of unspecified content.

        Raises GpuMemoryError where it is larger than a shader can address, or than the free memory.
        """
        dtype = np.dtype(dtype)
        if dtype not in (np.float32, np.float16, np.uint32):
            raise ValueError(f"expected float32, float16 or uint32, got {dtype}")
        size, limit = math.prod(shape) * dtype.itemsize, storage_limit(ctx)
        if size > limit:
            raise GpuMemoryError(
                f"array {list(shape)} {dtype} is {size / 1e6:.1f} MB, but a buffer may have {limit / 1e6:.1f} MB here "
                f"(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, {ctx.info['GL_RENDERER']}): use float16 or several arrays"
            )
        with current(ctx):
            buffer = ctx.buffer(reserve=-(-size // 4) * 4)
            full = ctx.error == "GL_OUT_OF_MEMORY"  # moderngl does not raise it
        if full:
            raise GpuMemoryError(
                f"array {list(shape)} {dtype}: {size / 1e6:.1f} MB more than {ctx.info['GL_RENDERER']} has memory for"
            )
        return cls(buffer, tuple(shape), dtype, label)

    @classmethod
    def upload(
        cls,
        ctx: moderngl.Context,
        values: np.ndarray,
        dtype: np.typing.DTypeLike = np.float32,
        label: str = "",
    ) -> GpuArray:
        """A copy of `values`, stored as `dtype`. Raises GpuMemoryError as `empty`."""
        values = np.ascontiguousarray(values, dtype)
        array = cls.empty(ctx, values.shape, dtype, label)
        with current(ctx):
            array.buffer.write(values)
        return array

    def read_plane(self, i: int) -> np.ndarray:
        """`read()[i]`, and no more than that."""
        values = np.empty(self.shape[1:], self.dtype)
        with current(self.buffer.ctx):
            self.buffer.read_into(values, values.nbytes, offset=i * values.nbytes)
        return values

    def write_plane(self, i: int, values: np.ndarray) -> None:
        """Replace `read()[i]`."""
        values = np.ascontiguousarray(values, self.dtype)
        with current(self.buffer.ctx):
            self.buffer.write(values, offset=i * values.nbytes)

    def read(self) -> np.ndarray:
        """A copy in main memory; waits for the shaders that write the array."""
        values = np.empty(self.shape, self.dtype)
        with current(self.buffer.ctx):
            self.buffer.read_into(values, values.nbytes)
        return values
