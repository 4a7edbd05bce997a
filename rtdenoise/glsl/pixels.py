"""The networks of `hybrid` that write pixels or filter albedo and normal before, and the passes from footprints to one
picture: `models.pixel_network`, `models.hybrid`, `ops.mix` and `ops.fireflies`."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice

import numpy as np

from ..constants import AROUND_CELL, FIREFLY_ALIKE, MIX_CELL
from ..models.hybrid_config import HybridConfig, PixelShape
from .context import GpuArray
from .dispatch import dispatch
from .network import BLOCKS, PackedLayer, conv_layer, convolve
from .passes import Inputs
from .scratch import Scratch

CELL_GROUP = (AROUND_CELL, AROUND_CELL)  # a work group for each cell of `ops.around`


class Pixels:
    """The passes of one model after its kernels."""

    def __init__(self, scratch: Scratch, config: HybridConfig, tensors: Mapping[str, np.ndarray]) -> None:
        self._scratch, self._many = scratch, config.many
        self._network = PixelNetwork(scratch, config.pixels, tensors, "pixels", "pixels")
        self._surfaces = Surfaces(scratch, config, tensors) if config.clean else None
        self._shares, self._needs_history = config.shares, config.kernels_need_history

    def mix(
        self,
        inputs: Inputs,
        past: GpuArray,  # [H, W] rgb, flags
        seen: GpuArray,  # [3, H, W] rgb, frames · albedo, trust · normal, stays: with this frame
        shown: GpuArray,  # the same with edges that move: what is filtered
        level: GpuArray,  # [3] of `Recent.level`
        result: GpuArray,  # [3, H, W] the kernels' picture, which becomes the mixture
        denoised: GpuArray,  # [H, W] the same as an image for history
    ) -> None:
        """Write pixels, mix them, the kernels' picture and the previous one, and take fireflies out."""
        H, W = inputs.surface.shape[:2]
        scratch, size, statistics = self._scratch, (W, H), inputs.statistics
        around, sums = (tuple(-(-n // cell) for n in (H, W)) for cell in (AROUND_CELL, MIX_CELL))
        cells, told = scratch.image("pixels.cells", around), scratch.image("pixels.told", sums)
        bounds, even = scratch("pixels.bounds", (2, *around, 4)), scratch.image("pixels.even", (H, W))
        written, mixed = (scratch.image(f"pixels.{name}", (H, W)) for name in ("written", "mixed"))
        pictures = {"light": inputs.light, "guide": inputs.guide, "denoised": denoised, "statistics": statistics}

        buffers = {"seen": seen, "past": past, "level": level, "cells": cells}
        dispatch("hybrid/cells", size, buffers, group=CELL_GROUP)
        if self._surfaces:
            shown = self._surfaces.clean(shown)
        features = self._network.input((H, W))
        padded = features.shape[2:0:-1]
        buffers = {"shown": shown, "denoised": denoised, "cells": cells, "statistics": statistics, "even": even}
        buffers |= {"level": level, "result": features}
        half = {"HALF": int(scratch.half)}
        dispatch("hybrid/features", padded, buffers, {"image_size": size}, EVEN=int(not self._many), **half)
        wrote = self._network(features)
        dispatch("hybrid/bounds", size, {"even": even, "denoised": denoised, "bounds": bounds}, group=CELL_GROUP)
        usual, before, least = self._shares
        buffers = pictures | {"compressed_light": wrote, "bounds": bounds, "written": written, "told": told}
        dispatch("hybrid/written", size, buffers, {"padded": padded}, USUAL=usual, **half)
        buffers = {"written": written, "past": past, "seen": seen, "cells": cells, "told": told}
        buffers |= {"statistics": statistics, "denoised": denoised, "mixed": mixed}
        needs = {"NEEDS_HISTORY": int(self._needs_history and inputs.more_history)}
        dispatch("hybrid/mix", size, buffers, USUAL=usual, BEFORE=before, LEAST=least, **needs)
        buffers = {"mixed": mixed, "surface": inputs.surface, "past": past, "seen": seen}
        buffers |= {"denoised": denoised, "result": result}
        dispatch("hybrid/fireflies", size, buffers, LEAST=9 if self._many else FIREFLY_ALIKE)


class Surfaces:
    """The networks that filter albedo and normal, one each."""

    def __init__(self, scratch: Scratch, config: HybridConfig, tensors: Mapping[str, np.ndarray]) -> None:
        """`config` has both. They have one shape, so that what is between their layers shares memory."""
        self._scratch = scratch
        self._networks = {
            name: PixelNetwork(scratch, shape, tensors, f"pixels.surfaces.{name}", "pixels.surfaces")
            for name, shape in config.surfaces.items()
        }

    def clean(self, shown: GpuArray) -> GpuArray:
        """`shown` as in `Pixels.mix`, with albedo and normal without noise."""
        size, half = shown.shape[1:3], {"HALF": int(self._scratch.half)}
        clean = self._scratch("pixels.clean", shown.shape)
        given = {name: network.input(size) for name, network in self._networks.items()}
        padded = given["albedo"].shape[2:0:-1]
        dispatch("hybrid/surfaces", padded, {"shown": shown, **given}, {"image_size": size[::-1]}, **half)
        found = {name: network(given[name]) for name, network in self._networks.items()}
        buffers = {"shown": shown, **found, "result": clean}
        dispatch("hybrid/clean", size[::-1], buffers, {"padded": padded}, **half)
        return clean


class PixelNetwork:
    """A U-Net from a picture to another: `models.pixel_network.PixelUNet`, with a ReLU after its last convolution."""

    def __init__(
        self,
        scratch: Scratch,
        shape: PixelShape,
        tensors: Mapping[str, np.ndarray],  # a state dict; only `NAME.*` is read
        name: str,  # also of its input and its output in `scratch`
        between: str,  # name of what is between its layers; networks of one shape may share it
    ) -> None:
        self._scratch, self._inputs, self._name, self._between = scratch, shape.inputs, name, between

        def layer(part: str, *sources: int) -> PackedLayer:
            return conv_layer(scratch.ctx, tensors, f"{name}.{part}", sources, BLOCKS)

        layers = iter([layer(f"encoder.{i}", n) for i, (n, _) in enumerate(shape.convolutions)])
        self._encoder = [[*islice(layers, count)] for count in shape.stages]
        self._decoder = [
            (layer(f"decoder.{i}.0", below, skip), layer(f"decoder.{i}.2", first))
            for i, (below, first, skip, _) in enumerate(shape.levels)
        ]
        self._last = layer("last", shape.out[0])

    def input(self, size: tuple[int, int]) -> GpuArray:
        """Where the input for a picture of `size` (H, W) belongs, [⌈inputs/4⌉, H', W', 4]: whole cells of the
        network."""
        cell = 2 ** len(self._decoder)
        return self._scratch.activations(f"{self._name}.input", self._inputs, tuple(n + -n % cell for n in size))

    def __call__(self, x: GpuArray) -> GpuArray:
        """The input, zero beyond the picture, to the output [1, H', W', 4]."""
        scratch, between, skips = self._scratch, self._between, []
        for level, stage in enumerate(self._encoder):
            x = self._pool(x, f"{between}.pooled.{level}") if level else x
            skips.append(x)
            for layer, name in zip(stage, ("first", "second"), strict=False):
                x = convolve(scratch, layer, f"{between}.{name}.{level}", x)
        for level in reversed(range(len(self._decoder))):
            first, second = self._decoder[level]
            x = convolve(scratch, first, f"{between}.joined.{level}", skips[level], x)
            x = convolve(scratch, second, f"{between}.last.{level}", x)
        return convolve(scratch, self._last, f"{self._name}.output", x)

    def _pool(self, x: GpuArray, name: str) -> GpuArray:
        groups, H, W, _ = x.shape
        result = self._scratch.activations(name, 4 * groups, (H // 2, W // 2))
        size = W // 2, H // 2
        dispatch("network/pool", (*size, groups), {"near": x, "result": result}, HALF=int(self._scratch.half))
        return result
