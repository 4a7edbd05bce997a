"""The buffers of a pipeline: those that it writes anew in every frame, and images that outlive one."""

from __future__ import annotations

import moderngl
import numpy as np

from .context import GpuArray


class Scratch:
    """Arrays by name, allocated when they are first asked for and again when their shape changes: in a sequence of
    frames of one size, after the first frame never."""

    def __init__(self, ctx: moderngl.Context, half: bool) -> None:
        """`half`: activations are stored as float16."""
        self.ctx, self.half = ctx, half
        self._arrays: dict[str, GpuArray] = {}

    def __call__(self, name: str, shape: tuple[int, ...], dtype: np.typing.DTypeLike = np.float32) -> GpuArray:
        """The array `name`, its content whatever was written last. Raises GpuMemoryError as `GpuArray.empty`."""
        array = self._arrays.get(name)
        if array is None or array.shape != shape or array.dtype != dtype:
            self._arrays[name] = array = GpuArray.empty(self.ctx, shape, dtype)
        return array

    def image(self, name: str, size: tuple[int, int]) -> GpuArray:
        """`size` is (H, W)."""
        return self(name, (*size, 4))

    def activations(self, name: str, channels: int, size: tuple[int, int]) -> GpuArray:
        """[⌈channels/4⌉, H, W, 4]: what the network hands on."""
        return self(name, (-(-channels // 4), *size, 4), np.float16 if self.half else np.float32)

    def fresh(self, size: tuple[int, int]) -> GpuArray:
        """An image that goes into history: nobody may write it again."""
        return GpuArray.empty(self.ctx, (*size, 4))

    @property
    def nbytes(self) -> int:
        """Bytes of all that have names."""
        return sum(array.buffer.size for array in self._arrays.values())
