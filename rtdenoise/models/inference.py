"""A trained network made ready to run: device, precision, memory layout, fused layers."""

from __future__ import annotations

import functools

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ..errors import InputError
from ..ops.convolve import MOST, convolve, mixed
from ..ops.convolve_bytes import multiplies_bytes
from ..ops.dispatch import compiled
from ..ops.features import filled
from .unet import ConvRelu, HeadsByCells, Up

INT8 = "int8"
PRECISIONS = ("auto", "fp32", "bf16", INT8)
LANES = 16  # channels of an input that cuDNN convolves fast in half precision
ROWS = 8  # a matrix has a multiple of so many rows there


def choose_device(name: str) -> str:
    """'auto' becomes CUDA where there is a GPU. Raises InputError for a device that is unknown or not there."""
    if name not in ("auto", "cpu", "cuda"):
        raise InputError(f"unknown device {name!r}; expected 'auto', 'cpu' or 'cuda'")
    device = name if name != "auto" else "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("device cuda: no CUDA device was found; use --device cpu")
    return device


def resolve(precision: str, device: str | torch.device) -> torch.dtype:
    """The dtype that `precision` means on a device, for what is not in bytes (`takes_bytes`). With 'auto', and with
    'int8', on CPUs alone, it is bfloat16 where the hardware multiplies that faster: CPUs with AVX512-BF16 or AMX, CUDA
    from compute capability 8.0; float32 elsewhere.

    Raises InputError for an unknown precision, and for 'int8' on another device.
    """
    if precision not in PRECISIONS:
        raise InputError(f"unknown precision {precision!r}; expected one of {', '.join(PRECISIONS)}")
    if precision == INT8 and torch.device(device).type != "cpu":
        raise InputError("precision int8 is for the CPU; take auto")
    if precision not in ("auto", INT8):
        return torch.bfloat16 if precision == "bf16" else torch.float32
    device = torch.device(device)
    if device.type == "cuda":
        fast = torch.cuda.get_device_capability(device) >= (8, 0)
    else:
        fast = device.type == "cpu" and _has("avx512_bf16")
    return torch.bfloat16 if fast else torch.float32


def takes_bytes(precision: str, device: str | torch.device) -> bool:
    """Whether a network that can computes in bytes: with 'int8', and with 'auto' on CPUs that multiply them
    (`multiplies_bytes`)."""
    if precision != "auto":
        return precision == INT8
    return torch.device(device).type == "cpu" and multiplies_bytes()


def automatic(device: str | torch.device) -> str:
    """The one of PRECISIONS that 'auto' means on a device, for a network that has weights in bytes."""
    if takes_bytes("auto", device):
        return INT8
    return "bf16" if resolve("auto", device) is torch.bfloat16 else "fp32"


def _has(instructions: str) -> bool:
    ask = getattr(torch.cpu, f"_is_{instructions}_supported", None)  # torch has no public name for it
    return ask is not None and ask()


def prepare(network: nn.Module, dtype: torch.dtype) -> nn.Module:
    """Prepare a network for inference, in place, on the device that it is on: weights in `dtype` and channels last,
    ReLUs fused into convolutions, enlargement fused into the decoder's (`_FusedUp`). Parameters keep their names. Not
    for training.

    Convolutions compute in channels last, on CPUs and on tensor cores; other layouts are converted in every call.
    `as_weights` converts the network's input. On CUDA a network in float32 stays as it is: cuDNN is slower otherwise.
    """
    device = next(network.parameters()).device
    if device.type == "cuda" and dtype == torch.float32:
        return network.float()
    fuses = _fuses(dtype, device)
    for module in list(network.modules()):
        if fuses and isinstance(module, nn.Sequential):
            _fuse(module)
        if fuses and type(module) is ConvRelu:
            module.__class__ = _FusedConvRelu
        if isinstance(module, Up):
            _FusedUp.take(module)
        if device.type == "cuda" and isinstance(module, HeadsByCells):
            _JoinedHeads.take(module)
        if device.type == "cuda" and type(module) is nn.Conv2d and module.kernel_size == (1, 1):
            _Product.take(module)
    if fuses and device.type == "cuda":
        for module in network.modules():
            if isinstance(module, _FusedConvRelu | _FusedUp):
                module.fill_lanes()
    if fuses and device.type == "cpu" and dtype == torch.float32 and compiled("cpu"):
        first = {up[0] for up in network.modules() if isinstance(up, _FusedUp)}  # which their levels do
        for module in network.modules():
            if isinstance(module, _FusedConvRelu | _FusedUp) and module not in first:
                module.filter_minimally()
    return network.to(dtype=dtype, memory_format=torch.channels_last)


def as_weights(x: Tensor, network: nn.Module) -> Tensor:
    """`x` in the dtype and, after `prepare`, the layout of the network's weights."""
    weights = [w for w in network.parameters() if w.ndim == 4]
    last = any(w.is_contiguous(memory_format=torch.channels_last) and not w.is_contiguous() for w in weights)
    return x.to(weights[0].dtype, memory_format=torch.channels_last if last else torch.preserve_format)


class _FusedConvRelu(ConvRelu):
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
        if _by_cudnn(x.dtype, x.device):
            return torch.cudnn_convolution_relu(
                x, weight, self.bias, self.stride, self.padding, self.dilation, self.groups
            )
        return F.relu(self._conv_forward(x, weight, self.bias))  # moved there since `prepare`


class _FusedUp(Up):
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
        """As that of `_FusedConvRelu`, for the skip connection."""
        self.of_skip = filled(self.of_skip, LANES)

    def filter_minimally(self) -> None:
        """As that of `_FusedConvRelu`; the coarser level is read at its own size here, too."""
        if max(self.below, self[0].in_channels - self.below) <= MOST:
            self.register_buffer("of_mixtures", mixed(self[0].weight, self.below), persistent=False)
            self.minimal = True

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        if self.minimal and x.device.type == "cpu":
            return self[3](self[2](convolve(skip, self[0].weight, self[0].bias, self.of_mixtures, x)))
        fused = type(self[0]) is _FusedConvRelu
        skip = filled(skip, self[0].lanes) if fused else skip
        if fused and _by_cudnn(x.dtype, x.device):
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


class _JoinedHeads(HeadsByCells):
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


class _Product(nn.Conv2d):
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


def _fuse(layers: nn.Sequential) -> None:
    for i in range(len(layers) - 1):
        convolution = layers[i]
        if type(convolution) is nn.Conv2d and isinstance(layers[i + 1], nn.ReLU):
            convolution.__class__ = _FusedConvRelu
            layers[i + 1] = nn.Identity()


def _fuses(dtype: torch.dtype, device: torch.device) -> bool:
    """Whether a library convolves with bias and ReLU at once: cuDNN on CUDA, oneDNN on a CPU. Older CPUs (AVX2) have no
    bfloat16: plain torch, which is slow in it, has to do."""
    if device.type != "cpu":
        return _by_cudnn(dtype, device)
    if not (torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_convolution_pointwise")):
        return False
    return dtype != torch.bfloat16 or torch.ops.mkldnn._is_mkldnn_bf16_supported()


def _by_cudnn(dtype: torch.dtype, device: torch.device) -> bool:
    """Whether cuDNN does: in half precision (in float32 it is slower so), on GPUs that have bfloat16."""
    if device.type != "cuda" or dtype == torch.float32 or torch.version.cuda is None:
        return False
    return torch.backends.cudnn.enabled and torch.backends.cudnn.is_available() and _has_bfloat16(device)


@functools.cache
def _has_bfloat16(device: torch.device) -> bool:  # that of a tensor, with its number
    return torch.cuda.get_device_capability(device) >= (8, 0)
