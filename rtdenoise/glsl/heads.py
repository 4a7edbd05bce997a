"""The weights of a network's heads, by scale and name, for `include/head.glsl`."""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl
import numpy as np

from ..models.presets import Config
from .context import GpuArray
from .network import PackedLayer, filled


class HeadLayer:
    """The last layer of the network, split by the names in `Config.heads`. A pass asks for the heads it applies."""

    def __init__(self, ctx: moderngl.Context, config: Config, tensors: Mapping[str, np.ndarray]) -> None:
        """`tensors` is a state dict."""
        self._ctx, self._layers = ctx, {}
        self._rows: list[dict[str, tuple[np.ndarray, np.ndarray]]] = []  # scale -> name -> weight, bias
        for scale, heads in enumerate(config.heads):
            weight, bias = _last_layer(tensors, scale)
            ends = np.cumsum([head.channels for head in heads])[:-1]
            parts = zip(np.split(weight, ends, axis=1), np.split(bias, ends), strict=True)
            self._rows.append(dict(zip((head.name for head in heads), parts, strict=True)))

    def has(self, scale: int, name: str) -> bool:
        """Whether the network predicts this head."""
        return name in self._rows[scale]

    def kernel(self, scale: int, name: str) -> int:
        """The side of the kernel that this head predicts."""
        return math.isqrt(len(self._rows[scale][name][1]))

    def layer(self, scale: int, *names: str) -> PackedLayer:
        """The rows of these heads one after the other, uploaded on the first call."""
        if (scale, names) not in self._layers:
            weights, biases = zip(*(self._rows[scale][name] for name in names), strict=True)
            self._layers[scale, names] = head_layer(
                self._ctx, np.concatenate(weights, axis=1), np.concatenate(biases), f"heads.{scale}.{'+'.join(names)}"
            )
        return self._layers[scale, names]


def head_layer(
    ctx: moderngl.Context,
    weight: np.ndarray,  # [cells, rows, inputs]: a matrix for each pixel of a cell
    bias: np.ndarray,  # [rows]
    label: str,  # of its arrays
) -> PackedLayer:
    """Rows of the last layer, packed for `include/head.glsl`."""
    packed = filled(filled(weight, 1, 4), 2, 4)
    cells, rows, inputs = packed.shape
    packed = packed.reshape(cells, rows // 4, 4, inputs // 4, 4).transpose(0, 1, 3, 4, 2)
    return PackedLayer(
        GpuArray.upload(ctx, packed, label=f"{label}.weight"),
        GpuArray.upload(ctx, filled(bias, 0, 4), label=f"{label}.bias"),
        (inputs // 4,),
        weight.shape[1],
    )


def _last_layer(tensors: Mapping[str, np.ndarray], scale: int) -> tuple[np.ndarray, np.ndarray]:
    """Weights [cells, rows, inputs] and biases [rows] of all heads of a scale."""
    finer = "full_head.weight" in tensors  # then the list `heads` starts at scale 1
    if finer and scale == 0:
        weight = tensors["full_head.weight"]  # a 2×2 transposed convolution with stride 2: [inputs, rows, 2, 2]
        return weight.transpose(2, 3, 1, 0).reshape(4, -1, weight.shape[0]), tensors["full_head.bias"]
    name = f"heads.{scale - finer}"
    return tensors[f"{name}.weight"][None, :, :, 0, 0], tensors[f"{name}.bias"]
