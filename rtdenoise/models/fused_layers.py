"""Layers as inference runs them: what convolves takes the bias, the ReLU and the enlargement with it."""

from __future__ import annotations

import functools

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..ops.convolve import MOST, convolve, mixed
from ..ops.features import filled
from .unet import ConvRelu, HeadsByCells, Up

LANES = 16  # channels of an input that cuDNN convolves fast in half precision
ROWS = 8  # a matrix has a multiple of so many rows there


class FusedConvRelu(ConvRelu):
    """Convolution, bias and ReLU in one pass, by our own C or oneDNN on a CPU and by cuDNN on CUDA."""

    minimal = False

    def fill_lanes(self) -> None:
        """Take as many channels as are fast, the last with weights of 0: of 3 or 8 they take twice the time of 16."""
        self.lanes = LANES
        self.register_buffer("filled", filled(self.weight.detach(), LANES), persistent=False)

    def filter_minimally(self) -> None:
        """Take half of the products in float32 on a CPU (`ops.convolve`)."""
        usual = self.kernel_size == (3, 3) and self.padding == (1, 1) and self.stride == (1, 1) and self.groups == 1
        if usual and self.in_channels <= MOST:
            self.register_buffer("of_mixtures", mixed(self.weight), persistent=False)
            self.minimal = True

    def forward(self, x: Tensor) -> Tensor:
        if self.minimal and x.device.type == "cpu":
            return convolve(x, self.weight, self.bias, self.of_mixtures)
        x, weight = (filled(x, self.lanes), self.filled) if self.lanes > 1 else (x, self.weight)
        if x.device.type == "cpu":
            return torch.ops.mkldnn._convolution_pointwise(
                x, weight, self.bias, self.padding, self.stride, self.dilation, self.groups, "relu", [], ""
            )
        if by_cudnn(x.dtype, x.device):
            return torch.cudnn_convolution_relu(
                x, weight, self.bias, self.stride, self.padding, self.dilation, self.groups
            )
        return F.relu(self._conv_forward(x, weight, self.bias))  # moved there since `prepare`


class FusedUp(Up):
    """A level of the decoder with its first convolution split in two: one of the skip connection, and one of the
    coarser level at the coarser size.

    After nearest upsampling a 3×3 window covers only 2×2 distinct pixels. Upsampling and convolution together are
    therefore a 4×4 transposed convolution with stride 2 whose weights are sums of the 3×3 ones: 16 products a channel
    instead of 36, and neither the enlarged picture nor the joined one is ever stored.
    """

    minimal = False

    @classmethod
    def take(cls, up: Up) -> None:
        """Turn `up` into this class, in place. Its own weights keep their names."""
        weight = up[0].weight.detach()
        up.register_buffer("of_below", enlarging(weight[:, : up.below]), persistent=False)
        up.register_buffer("of_skip", weight[:, up.below :].clone(), persistent=False)
        up.__class__ = cls

    def fill_lanes(self) -> None:
        """As that of `FusedConvRelu`, for the skip connection."""
        self.of_skip = filled(self.of_skip, LANES)

    def filter_minimally(self) -> None:
        """As that of `FusedConvRelu`; the coarser level is read at its own size here, too."""
        if max(self.below, self[0].in_channels - self.below) <= MOST:
            self.register_buffer("of_mixtures", mixed(self[0].weight, self.below), persistent=False)
            self.minimal = True

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        if self.minimal and x.device.type == "cpu":
            return self[3](self[2](convolve(skip, self[0].weight, self[0].bias, self.of_mixtures, x)))
        fused = type(self[0]) is FusedConvRelu
        skip = filled(skip, self[0].lanes) if fused else skip
        if fused and by_cudnn(x.dtype, x.device):
            y = F.conv_transpose2d(x, self.of_below, stride=2, padding=1)
            y = torch.cudnn_convolution_add_relu(skip, self.of_skip, y, 1.0, self[0].bias, (1, 1), (1, 1), (1, 1), 1)
            return self[3](self[2](y))
        y = F.conv_transpose2d(x, self.of_below, self[0].bias, stride=2, padding=1)
        if fused and x.device.type == "cpu":
            torch.ops.mkldnn._convolution_pointwise_.binary(
                y, skip, self.of_skip, None, (1, 1), (1, 1), (1, 1), 1, "add", 1.0, "relu", [], ""
            )
        else:
            y = F.relu(y + F.conv2d(skip, self.of_skip, padding=1))
        return self[3](self[2](y))


def enlarging(weight: Tensor) -> Tensor:
    """Turn the weights of a 3×3 convolution, `[O, I, 3, 3]`, into weights `[I, O, 4, 4]` for `conv_transpose2d(x, ...,
    stride=2, padding=1)` that convolve x after nearest ×2 upsampling.

    Along each axis pixel 2i sees i - 1 with tap 0 and i with taps 1 and 2; pixel 2i + 1 sees i with taps 0 and 1 and
    i + 1 with tap 2. Tap t of the transposed convolution leads from pixel i to pixel 2i + t - 1.
    """
    sums = weight.new_tensor([[0, 0, 1], [0, 1, 1], [1, 1, 0], [1, 0, 0]])
    return torch.einsum("ty,oiyx,sx->iots", sums, weight, sums)


class JoinedHeads(HeadsByCells):
    """All heads in one product of matrices, for a GPU."""

    @classmethod
    def take(cls, heads: HeadsByCells) -> None:
        """Turn `heads` into this class, in place."""
        weights, biases = zip(*heads.pointwise(), strict=True)
        heads.register_buffer("matrix", torch.cat([_in_rows(w.detach().flatten(1)) for w in weights]), persistent=False)
        heads.register_buffer("offset", torch.cat([_in_rows(b.detach()) for b in biases]), persistent=False)
        heads.__class__ = cls

    def forward(self, x: Tensor) -> list[Tensor]:
        sizes = [4 * size for size in self.sizes]
        parts = _product(x, self.matrix, self.offset).split([n + -n % ROWS for n in sizes], dim=1)
        return [part[:, :n].unflatten(1, (2, 2, n // 4)) for part, n in zip(parts, sizes, strict=True)]


class Product(nn.Conv2d):
    """A 1×1 convolution as a product of matrices, for a GPU: it adds a bias as well."""

    @classmethod
    def take(cls, convolution: nn.Conv2d) -> None:
        """Turn `convolution` into this class, in place."""
        weight, bias = convolution.weight.detach().flatten(1), convolution.bias
        convolution.register_buffer("matrix", _in_rows(weight), persistent=False)
        convolution.register_buffer("offset", None if bias is None else _in_rows(bias.detach()), persistent=False)
        convolution.__class__ = cls

    def forward(self, x: Tensor) -> Tensor:
        return _product(x, self.matrix, self.offset)[:, : self.out_channels]


def _product(x: Tensor, matrix: Tensor, offset: Tensor | None) -> Tensor:
    return F.linear(x.permute(0, 2, 3, 1), matrix, offset).permute(0, 3, 1, 2)


def _in_rows(x: Tensor) -> Tensor:
    """With zeros for as many rows as tensor cores write at once."""
    return F.pad(x, (*(0, 0) * (x.ndim - 1), 0, -len(x) % ROWS))


def by_cudnn(dtype: torch.dtype, device: torch.device) -> bool:
    """Whether cuDNN does: in half precision (in float32 it is slower so), on GPUs that have bfloat16."""
    if device.type != "cuda" or dtype == torch.float32 or torch.version.cuda is None:
        return False
    return torch.backends.cudnn.enabled and torch.backends.cudnn.is_available() and _has_bfloat16(device)


@functools.cache
def _has_bfloat16(device: torch.device) -> bool:  # that of a tensor, with its number
    return torch.cuda.get_device_capability(device) >= (8, 0)
