"""Blocks of attention between channels and gated feed-forward layers (Zamir et al. 2022, *Restormer*), and blocks that
also attend to features of the frame before (Chen, He, Li 2024).

Without gradients a large picture is taken in strips of rows (`strips`), so that wide intermediate features exist for
one strip only. A depth-wise 3×3 convolution reads one row beyond its strip; the sums of attention add up over strips.
So the result is that of the whole picture, up to rounding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..ops.attend_channels import mix, sums
from .mltd_config import Stage, hidden_channels

STRIP_PIXELS = 1 << 16  # of a strip: wide features of one take some tens of MB


def strips(picture: Tensor, halo: int = 1) -> Iterator[tuple[slice, slice, slice]]:
    """Rows of `picture` `[B, C, H, W]` in strips: (a strip with `halo` more rows on both sides where there are any, the
    strip itself, its place in the former). One strip of all rows with gradients, or where the picture is small."""
    H, W = picture.shape[2:]
    rows = H if torch.is_grad_enabled() else max(8, STRIP_PIXELS // W)
    for top in range(0, H, rows):
        bottom, first = min(top + rows, H), max(0, top - halo)
        yield slice(first, min(bottom + halo, H)), slice(top, bottom), slice(top - first, bottom - first)


def in_strips(function: Callable[[Tensor], Tensor], picture: Tensor) -> Tensor:
    """`function(picture)`, strip by strip: a function of a picture that reads one row beyond each."""
    out = None
    for window, core, inner in strips(picture):
        if core == slice(0, picture.shape[2]):
            return function(picture)
        part = function(picture[:, :, window])[:, :, inner]
        if out is None:
            out = part.new_empty(*part.shape[:2], *picture.shape[2:])
        out[:, :, core] = part
    return out


class Points(nn.Conv2d):
    """A 1×1 convolution as the matrix product that it is; the layout is that of channels last."""

    def __init__(self, inputs: int, outputs: int, bias: bool = False) -> None:
        super().__init__(inputs, outputs, 1, bias=bias)

    def forward(self, x: Tensor) -> Tensor:
        return points(x, self.weight, self.bias)

    def of_two(self, x: Tensor, y: Tensor) -> Tensor:
        """The convolution of both, joined along the channels; the joined picture is never stored."""
        weights = self.weight.split([x.shape[1], y.shape[1]], dim=1)
        return points(x, weights[0], self.bias) + points(y, weights[1])


def points(x: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    """`F.conv2d` with a weight `[O, I, 1, 1]`."""
    return F.linear(x.permute(0, 2, 3, 1), weight.flatten(1), bias).permute(0, 3, 1, 2)


class Norm(nn.Module):
    """Layer normalisation over the channels of a pixel without bias: x / √(var + 1e-5) · scale. The mean stays."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(width))

    def forward(self, x: Tensor) -> Tensor:
        variance = x.float().var(1, correction=0, keepdim=True)
        return x * (variance + 1e-5).rsqrt().to(x.dtype) * self.scale.reshape(-1, 1, 1).to(x.dtype)


class Projection(nn.Module):
    """A 1×1 convolution, then a depth-wise 3×3 one; no biases. It reads one row beyond each."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.points = Points(inputs, outputs)
        self.depthwise = nn.Conv2d(outputs, outputs, 3, padding=1, groups=outputs, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        return self.depthwise(self.points(x))


class FeedForward(nn.Module):
    """x + W (GELU(a) · b), with a and b from a projection of the normalised x."""

    def __init__(self, width: int) -> None:
        super().__init__()
        hidden = hidden_channels(width)
        self.norm, self.expand = Norm(width), Projection(width, 2 * hidden)
        self.out = Points(hidden, width)

    def forward(self, x: Tensor) -> Tensor:
        def layer(x: Tensor) -> Tensor:
            a, b = self.expand(self.norm(x)).chunk(2, dim=1)
            return x + self.out(F.gelu(a) * b)

        return in_strips(layer, x)


class Attention(nn.Module):
    """x + W [self-attention, cross-attention], each between the channels of the heads.

    Queries, keys and values of the former are projections of the normalised x. The latter has queries from there, but
    keys and values from hidden features, normalised alike. Features that are zero, or None, contribute nothing. A stage
    that is recurrent by concatenation joins them to x instead.
    """

    def __init__(self, width: int, heads: int, recurrence: str) -> None:
        super().__init__()
        self.heads, self.cross, self.concat = heads, recurrence == "cross", recurrence == "concat"
        self.norm, self.qkv = Norm(width), Projection(width, 3 * width)
        self.temperature = nn.Parameter(torch.ones(heads))
        if self.cross:
            self.cross_q, self.cross_kv = Projection(width, width), Projection(width, 2 * width)
            self.cross_temperature = nn.Parameter(torch.ones(heads))
        if self.concat:
            self.merge = Points(2 * width, width)
        self.out = Points((1 + self.cross) * width, width)

    def forward(self, x: Tensor, hidden: Tensor | None = None) -> Tensor:
        if self.concat:
            x = self.merge(torch.cat([x, torch.zeros_like(x) if hidden is None else hidden], dim=1))
        attended = [self._attended(x, x, self.qkv, None, self.temperature)]
        if self.cross and hidden is not None:
            attended.append(self._attended(x, hidden, self.cross_kv, self.cross_q, self.cross_temperature))
        weight = self.out.weight[:, : len(attended) * x.shape[1]]
        if len(list(strips(x))) == 1:
            return x + points(torch.cat([mix(*pair) for pair in attended], dim=1), weight)
        out = torch.empty_like(x)
        for _, core, _ in strips(x):
            mixed = torch.cat([mix(weights, values[:, :, core]) for weights, values in attended], dim=1)
            out[:, :, core] = x[:, :, core] + points(mixed, weight)
        return out

    def _attended(
        self, x: Tensor, source: Tensor, project: Projection, queries: Projection | None, temperature: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Attention weights and values: queries from x, keys and values from `source`."""
        found, values = None, None
        for window, core, inner in strips(x):
            projected = project(self.norm(source[:, :, window]))
            if queries is not None:
                projected = torch.cat([queries(self.norm(x[:, :, window])), projected], dim=1)
            q, k, v = projected[:, :, inner].chunk(3, dim=1)
            part = sums(q, k, self.heads)
            found = part if found is None else found + part
            if core == slice(0, x.shape[2]):
                return found.weights(temperature), v
            values = v.new_empty(x.shape) if values is None else values
            values[:, :, core] = v
        return found.weights(temperature), values


class Block(nn.Module):
    """Attention, then a feed-forward layer, both residual."""

    def __init__(self, width: int, heads: int, recurrence: str = "none") -> None:
        super().__init__()
        self.attention, self.feed_forward = Attention(width, heads, recurrence), FeedForward(width)

    def forward(self, x: Tensor, hidden: Tensor | None = None) -> Tensor:
        """`[B, width, H, W]` to the same; `hidden` likewise, from the frame before."""
        return self.feed_forward(self.attention(x, hidden))


def blocks(stage: Stage, recurrence: str) -> nn.ModuleList:
    """The blocks of a stage."""
    kind = recurrence if stage.recurrent else "none"
    return nn.ModuleList(Block(stage.width, stage.heads, kind) for _ in range(stage.blocks))
