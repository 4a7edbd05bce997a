"""Buffers that a pipeline writes anew in every frame."""

from __future__ import annotations

import moderngl
import numpy as np

from .context import GpuArray


class Scratch:
    """Arrays by name, allocated when they are first asked for and again when their shape changes: in a sequence of
    frames of one size, after the first frame never."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self._arrays: dict[str, GpuArray] = {}

    def __call__(self, name: str, shape: tuple[int, ...], dtype: np.typing.DTypeLike = np.float32) -> GpuArray:
        """The array `name`, its content whatever was written last. Raises GpuMemoryError as `GpuArray.empty`."""
        array = self._arrays.get(name)
        if array is None or array.shape != shape or array.dtype != dtype:
            self._arrays[name] = array = GpuArray.empty(self._ctx, shape, dtype)
        return array

    @property
    def nbytes(self) -> int:
        """Bytes of all of them."""
        return sum(array.buffer.size for array in self._arrays.values())
