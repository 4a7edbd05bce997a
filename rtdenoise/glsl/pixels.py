"""The network of `hybrid` that writes pixels, and the passes from footprints to one picture: `models.hybrid` and
`models.mixing`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..constants import AROUND_CELL, MIX_CELL
from ..models.hybrid_config import HybridConfig
from .context import GpuArray
from .dispatch import dispatch
from .network import BLOCKS, CONCATENATED, NEAR, PackedLayer, conv_layer, convolve
from .passes import Inputs
from .scratch import Scratch

CELL_GROUP = (AROUND_CELL, AROUND_CELL)  # a work group for each cell of `ops.around`


class Pixels:
    """The passes of one model after its kernels."""

    def __init__(self, scratch: Scratch, config: HybridConfig, tensors: Mapping[str, np.ndarray]) -> None:
        self._scratch, self._many = scratch, config.many
        self._network = PixelNetwork(scratch, config, tensors)
        self._shares = config.shares

    def mix(
        self,
        inputs: Inputs,
        past: GpuArray,  # [H, W] rgb, flags
        seen: GpuArray,  # [3, H, W] rgb, frames · albedo, trust · normal: with this frame
        shown: GpuArray,  # the same with edges that move: what is filtered
        result: GpuArray,  # [3, H, W] the kernels' picture, which becomes the mixture
        denoised: GpuArray,  # [H, W] the same as an image for history
    ) -> None:
        """Write pixels, and mix them, the kernels' picture and the previous one."""
        H, W = inputs.surface.shape[:2]
        scratch, size, statistics = self._scratch, (W, H), inputs.statistics
        around, sums = (tuple(-(-n // cell) for n in (H, W)) for cell in (AROUND_CELL, MIX_CELL))
        cells, told = scratch.image("pixels.cells", around), scratch.image("pixels.told", sums)
        bounds, even = scratch("pixels.bounds", (2, *around, 4)), scratch.image("pixels.even", (H, W))
        written = scratch.image("pixels.written", (H, W))
        pictures = {"light": inputs.light, "guide": inputs.guide, "denoised": denoised, "statistics": statistics}

        dispatch("hybrid/cells", size, {"seen": seen, "past": past, "cells": cells}, group=CELL_GROUP)
        features = self._network.input((H, W))
        padded = features.shape[2:0:-1]
        buffers = {"shown": shown, "denoised": denoised, "cells": cells, "statistics": statistics, "even": even}
        buffers["result"], half = features, {"HALF": int(scratch.half)}
        dispatch("hybrid/features", padded, buffers, {"image_size": size}, EVEN=int(not self._many), **half)
        wrote = self._network(features)
        dispatch("hybrid/bounds", size, {"even": even, "denoised": denoised, "bounds": bounds}, group=CELL_GROUP)
        usual, before, least = self._shares
        buffers = pictures | {"compressed_light": wrote, "bounds": bounds, "written": written, "told": told}
        dispatch("hybrid/written", size, buffers, {"padded": padded}, USUAL=usual, **half)
        buffers = {"written": written, "past": past, "seen": seen, "cells": cells, "told": told}
        buffers |= {"statistics": statistics, "denoised": denoised, "result": result}
        dispatch("hybrid/mix", size, buffers, USUAL=usual, BEFORE=before, LEAST=least)


class PixelNetwork:
    """A U-Net from footprints to compressed light."""

    def __init__(self, scratch: Scratch, config: HybridConfig, tensors: Mapping[str, np.ndarray]) -> None:
        """`tensors` is a state dict; only `pixels.*` is read."""
        self._scratch, self._inputs = scratch, config.inputs

        def layer(name: str, *sources: int) -> PackedLayer:
            return conv_layer(scratch.ctx, tensors, f"pixels.{name}", sources, BLOCKS)

        self._encoder = [layer(f"encoder.{i}", n) for i, (n, _) in enumerate(config.convolutions)]
        self._decoder = [
            (layer(f"decoder.{i}.0", below, skip), layer(f"decoder.{i}.2", first))
            for i, (below, first, skip, _) in enumerate(config.levels)
        ]
        self._last = layer("last", config.out[0])

    def input(self, size: tuple[int, int]) -> GpuArray:
        """Where the features of a picture of `size` (H, W) belong, [⌈inputs/4⌉, H', W', 4]: whole cells of the
        network."""
        cell = 2 ** len(self._decoder)
        return self._scratch.activations("pixels.features", self._inputs, tuple(n + -n % cell for n in size))

    def __call__(self, features: GpuArray) -> GpuArray:
        """Features, zero beyond the picture, to compressed light [1, H', W', 4]."""
        first, second, *deeper, deepest = self._encoder
        x, skips = self._convolve(second, "second.0", self._convolve(first, "first.0", features)), [features]
        for level, layer in enumerate(deeper, 1):
            x = self._pool(x, f"pooled.{level}")
            skips.append(x)
            x = self._convolve(layer, f"first.{level}", x)
        x = self._convolve(deepest, "deepest", x)
        for level in reversed(range(len(self._decoder))):
            join, convolve = self._decoder[level]
            x = self._convolve(join, f"joined.{level}", skips[level], far=x)
            x = self._convolve(convolve, f"last.{level}", x)
        return self._convolve(self._last, "output", x)

    def _convolve(self, layer: PackedLayer, name: str, near: GpuArray, far: GpuArray | None = None) -> GpuArray:
        return convolve(self._scratch, layer, NEAR if far is None else CONCATENATED, f"pixels.{name}", near, far)

    def _pool(self, x: GpuArray, name: str) -> GpuArray:
        groups, H, W, _ = x.shape
        result = self._scratch.activations(f"pixels.{name}", 4 * groups, (H // 2, W // 2))
        size = W // 2, H // 2
        dispatch("network/pool", (*size, groups), {"near": x, "result": result}, HALF=int(self._scratch.half))
        return result
