"""The buffers of a pipeline: those that every frame overwrites, and images that outlive a frame."""

from __future__ import annotations

import moderngl
import numpy as np

from .context import GpuArray


class Scratch:
    """Arrays by name, allocated on first use and again when their shape changes. A sequence of frames of one size
    allocates nothing after its first frames."""

    def __init__(self, ctx: moderngl.Context, half: bool) -> None:
        """`half`: activations are stored as float16."""
        self.ctx, self.half = ctx, half
        self._arrays: dict[str, GpuArray] = {}

    def __call__(self, name: str, shape: tuple[int, ...], dtype: np.typing.DTypeLike = np.float32) -> GpuArray:
        """The array `name` with its last content. Raises GpuMemoryError as `GpuArray.empty`."""
        array = self._arrays.get(name)
        if array is None or array.shape != shape or array.dtype != dtype:
            self._arrays[name] = array = GpuArray.empty(self.ctx, shape, dtype, name)
        return array

    def image(self, name: str, size: tuple[int, int]) -> GpuArray:
        """`size` is (H, W)."""
        return self(name, (*size, 4))

    def activations(self, name: str, channels: int, size: tuple[int, int]) -> GpuArray:
        """Activations of the network, [⌈channels/4⌉, H, W, 4]."""
        return self(name, (-(-channels // 4), *size, 4), np.float16 if self.half else np.float32)

    def fresh(self, size: tuple[int, int]) -> GpuArray:
        """An image for history, which nobody overwrites."""
        return GpuArray.empty(self.ctx, (*size, 4))

    @property
    def nbytes(self) -> int:
        """Bytes of all named arrays."""
        return sum(array.buffer.size for array in self._arrays.values())
