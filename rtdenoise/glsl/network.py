"""The network on the GPU, from the weights as stored: the U-Net (`models.unet.UNet`) and the stem before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import moderngl
import numpy as np

from .context import GpuArray
from .dispatch import dispatch
from .scratch import Scratch

BLOCKS, PIXELS = 2, 4  # groups of four output channels, and pixels, that an invocation of conv3x3 computes
CONV_GROUP = (8, 8)


@dataclass(frozen=True)
class PackedLayer:
    """Weights of a convolution or a head as shaders read them: in 4×4 blocks, […, 4 inputs, 4 outputs]."""

    weights: GpuArray  # [groups out, groups in, taps, 4, 4]; heads: [cells, groups out, groups in, 4, 4]
    biases: GpuArray  # [groups out, 4]
    groups: tuple[int, ...]  # of four inputs, for each of the tensors that are concatenated into the input
    outputs: int


def conv_layer(
    ctx: moderngl.Context,
    tensors: Mapping[str, np.ndarray],  # a state dict
    name: str,  # of the layer in it: NAME.weight [outputs, inputs, kernel, kernel], NAME.bias [outputs]
    sources: tuple[int, ...],  # channels of the tensors that are concatenated into the input
    blocks: int = 1,  # pad the groups out to a multiple of this
    order: Sequence[int] | None = None,  # of the input channels, where the shader has another
) -> PackedLayer:
    """A convolution, packed for `conv3x3` and `stem`."""
    weight, bias = tensors[f"{name}.weight"], tensors[f"{name}.bias"]
    weight = weight if order is None else weight[:, order]
    outputs, taps = weight.shape[0], weight.shape[2] * weight.shape[3]
    parts = np.split(weight.reshape(outputs, -1, taps), np.cumsum(sources)[:-1], axis=1)
    inputs = np.concatenate([filled(part, 1, 4) for part in parts], axis=1)
    packed = filled(inputs, 0, 4 * blocks).reshape(-1, 4, inputs.shape[1] // 4, 4, taps)  # og, out, ig, in, taps
    return PackedLayer(
        GpuArray.upload(ctx, packed.transpose(0, 2, 4, 3, 1), label=f"{name}.weight"),
        GpuArray.upload(ctx, filled(bias, 0, 4 * blocks).reshape(-1, 4), label=f"{name}.bias"),
        tuple(-(-n // 4) for n in sources),
        outputs,
    )


def convolve(
    scratch: Scratch,
    layer: PackedLayer,
    name: str,  # of the result in `scratch`
    near: GpuArray,  # [⌈C/4⌉, H, W, 4]
    far: GpuArray | None = None,  # [⌈C'/4⌉, H/2, W/2, 4], enlarged and put before `near`
    pooled: bool = False,  # of `near` the maxima of 2×2
) -> GpuArray:  # [⌈outputs/4⌉, H, W, 4]; pooled: of half the size
    """A 3×3 convolution with ReLU: `network/conv3x3`."""
    H, W = (n >> pooled for n in near.shape[1:3])
    result = scratch.activations(name, layer.outputs, (H, W))
    groups = result.shape[0]
    dispatch(
        "network/conv3x3", (-(-W // PIXELS), H, -(-groups // BLOCKS)),
        {"near": near, "far": near if far is None else far, "weights": layer.weights, "biases": layer.biases,
         "result": result},
        {"size": (W, H), "groups": (layer.groups[0], sum(layer.groups), groups)},
        CONV_GROUP, SOURCE=1 if pooled else 0 if far is None else 2, HALF=int(scratch.half),
    )  # fmt: skip
    return result


def filled(array: np.ndarray, axis: int, multiple: int) -> np.ndarray:
    """The array with zeros appended along `axis`, up to a multiple."""
    padding = [(0, 0)] * array.ndim
    padding[axis] = (0, -array.shape[axis] % multiple)
    return np.pad(array, padding)


class UNet:
    """Features in, decoder features of the finest levels out. Tensors are padded to whole cells."""

    def __init__(
        self,
        scratch: Scratch,
        tensors: Mapping[str, np.ndarray],  # a state dict; only `unet.*` is read
        inputs: int,
        widths: tuple[int, ...],
    ) -> None:
        ctx = scratch.ctx

        def double(name: str, sources: tuple[int, ...], width: int) -> tuple[PackedLayer, PackedLayer]:
            first, second = (
                conv_layer(ctx, tensors, f"unet.{name}.{i}", channels, BLOCKS)
                for i, channels in ((0, sources), (2, (width,)))
            )
            return first, second

        self._scratch = scratch
        self._encoder = [double(f"encoder.{i}", (n,), w) for i, (n, w) in enumerate(pairwise((inputs, *widths)))]
        self._decoder = [
            double(f"decoder.{i}", (below, width), width) for i, (width, below) in enumerate(pairwise(widths))
        ]

    @property
    def cell(self) -> int:
        """Height and width of the input must be multiples of this."""
        return 2 ** (len(self._encoder) - 1)

    def __call__(self, features: GpuArray) -> list[GpuArray]:
        """Features [⌈inputs/4⌉, H, W, 4] to [⌈widths[l]/4⌉, H/2^l, W/2^l, 4] for every level but the coarsest, finest
        first."""
        x, skips = features, []
        for level, (first, second) in enumerate(self._encoder):
            x = convolve(self._scratch, first, f"first.{level}", x, pooled=level > 0)
            x = convolve(self._scratch, second, f"second.{level}", x)
            skips.append(x)
        for level in reversed(range(len(self._decoder))):
            first, second = self._decoder[level]
            x = convolve(self._scratch, first, f"first.{level}", skips[level], x)
            x = skips[level] = convolve(self._scratch, second, f"second.{level}", x)  # overwrites the skip
        return skips[:-1]


class HalfSizeUNet:
    """A U-Net behind a stem, a strided convolution that halves the image."""

    cell = 2  # height and width of the input must be multiples of this

    def __init__(
        self,
        scratch: Scratch,
        tensors: Mapping[str, np.ndarray],  # a state dict; only `stem.*` and `unet.*` are read
        order: Sequence[int],  # of the input channels: where the shader has each of them
        widths: tuple[int, ...],
    ) -> None:
        self._scratch, self._unet = scratch, UNet(scratch, tensors, widths[0], widths)
        self._stem = conv_layer(scratch.ctx, tensors, "stem", (len(order),), order=order)

    def __call__(self, features: GpuArray, groups: int) -> list[GpuArray]:
        """As `UNet`, at half size. Only the first `groups` of four features are read; the others are zero."""
        half = tuple(n // 2 for n in features.shape[2:0:-1])
        W, H = (n + -n % self._unet.cell for n in half)
        result = self._scratch.activations("stem", self._stem.outputs, (H, W))
        dispatch(
            "network/stem", (W, H, result.shape[0]),
            {"features": features, "weights": self._stem.weights, "biases": self._stem.biases, "result": result},
            {"half_size": half, "groups": (groups, self._stem.groups[0])}, HALF=int(self._scratch.half),
        )  # fmt: skip
        return self._unet(result)
