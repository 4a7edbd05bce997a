"""A trained network made ready to run: its numbers, their layout in memory, and what can be fused."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..errors import InputError

PRECISIONS = ("auto", "fp32", "bf16")


def resolve(precision: str, device: str | torch.device) -> torch.dtype:
    """The dtype that `precision` means on a device. 'auto' is bfloat16 where the hardware multiplies it faster: CPUs
    with AVX512-BF16 or AMX, CUDA from compute capability 8.0; float32 elsewhere.

    Raises InputError for an unknown precision.
    """
    if precision not in PRECISIONS:
        raise InputError(f"unknown precision {precision!r}; expected one of {', '.join(PRECISIONS)}")
    if precision != "auto":
        return torch.bfloat16 if precision == "bf16" else torch.float32
    device = torch.device(device)
    if device.type == "cuda":
        fast = torch.cuda.get_device_capability(device) >= (8, 0)
    else:
        ask = getattr(torch.cpu, "_is_avx512_bf16_supported", None)  # torch has no public name for it
        fast = device.type == "cpu" and ask is not None and ask()
    return torch.bfloat16 if fast else torch.float32


def prepare(network: nn.Module, dtype: torch.dtype) -> nn.Module:
    """The network, changed in place: weights in `dtype` and channels last, each ReLU part of the convolution before it.

    Channels last is the layout that convolutions compute in, on CPUs and on tensor cores; in any other they turn their
    input and output around. `as_weights` brings the input to it. Not for training. Parameters keep their names.
    """
    for module in list(network.modules()):
        if isinstance(module, nn.Sequential):
            _fuse(module)
    return network.to(dtype=dtype, memory_format=torch.channels_last)


def as_weights(x: Tensor, network: nn.Module) -> Tensor:
    """`x` in the dtype and, after `prepare`, the layout of the network's weights."""
    weights = [w for w in network.parameters() if w.ndim == 4]
    last = any(w.is_contiguous(memory_format=torch.channels_last) and not w.is_contiguous() for w in weights)
    return x.to(weights[0].dtype, memory_format=torch.channels_last if last else torch.preserve_format)


class _ConvRelu(nn.Conv2d):
    """A convolution with its ReLU, in one pass where torch has oneDNN's (CPU)."""

    def forward(self, x: Tensor) -> Tensor:
        if x.device.type != "cpu":
            return super().forward(x).relu_()
        return torch.ops.mkldnn._convolution_pointwise(
            x, self.weight, self.bias, self.padding, self.stride, self.dilation, self.groups, "relu", [], ""
        )


def _fuse(layers: nn.Sequential) -> None:
    for i in range(len(layers) - 1):
        convolution = layers[i]
        if type(convolution) is nn.Conv2d and isinstance(layers[i + 1], nn.ReLU) and _has_onednn():
            convolution.__class__ = _ConvRelu
            layers[i + 1] = nn.Identity()


def _has_onednn() -> bool:
    return torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_convolution_pointwise")
