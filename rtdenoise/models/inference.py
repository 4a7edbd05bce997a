"""A trained network made ready to run: device, precision, memory layout, fused layers."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..errors import InputError
from ..ops.convolve_bytes import multiplies_bytes
from ..ops.dispatch import compiled
from .fused_layers import FusedConvRelu, FusedUp, JoinedHeads, Product, by_cudnn
from .unet import ConvRelu, HeadsByCells, Up

INT8 = "int8"
PRECISIONS = ("auto", "fp32", "bf16", INT8)


def choose_device(name: str | torch.device) -> str:
    """'auto' becomes CUDA where there is a GPU. Raises InputError for a device that is unknown or not there."""
    name = str(name) if isinstance(name, torch.device) else name
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
    ReLUs fused into convolutions, enlargement fused into the decoder's (`FusedUp`). Parameters keep their names. Not
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
            module.__class__ = FusedConvRelu
        if isinstance(module, Up):
            FusedUp.take(module)
        if device.type == "cuda" and isinstance(module, HeadsByCells):
            JoinedHeads.take(module)
        if device.type == "cuda" and type(module) is nn.Conv2d and module.kernel_size == (1, 1):
            Product.take(module)
    if fuses and device.type == "cuda":
        for module in network.modules():
            if isinstance(module, FusedConvRelu | FusedUp):
                module.fill_lanes()
    if fuses and device.type == "cpu" and dtype == torch.float32 and compiled("cpu"):
        first = {up[0] for up in network.modules() if isinstance(up, FusedUp)}  # which their levels do
        for module in network.modules():
            if isinstance(module, FusedConvRelu | FusedUp) and module not in first:
                module.filter_minimally()
    return network.to(dtype=dtype, memory_format=torch.channels_last)


def as_weights(x: Tensor, network: nn.Module) -> Tensor:
    """`x` in the dtype and, after `prepare`, the layout of the network's weights."""
    weights = [w for w in network.parameters() if w.ndim == 4]
    last = any(w.is_contiguous(memory_format=torch.channels_last) and not w.is_contiguous() for w in weights)
    return x.to(weights[0].dtype, memory_format=torch.channels_last if last else torch.preserve_format)


def _fuse(layers: nn.Sequential) -> None:
    for i in range(len(layers) - 1):
        convolution = layers[i]
        if type(convolution) is nn.Conv2d and isinstance(layers[i + 1], nn.ReLU):
            convolution.__class__ = FusedConvRelu
            layers[i + 1] = nn.Identity()


def _fuses(dtype: torch.dtype, device: torch.device) -> bool:
    """Whether a library convolves with bias and ReLU at once: cuDNN on CUDA, oneDNN on a CPU. Older CPUs (AVX2) have no
    bfloat16: plain torch, which is slow in it, has to do."""
    if device.type != "cpu":
        return by_cudnn(dtype, device)
    if not (torch.backends.mkldnn.is_available() and hasattr(torch.ops.mkldnn, "_convolution_pointwise")):
        return False
    return dtype != torch.bfloat16 or torch.ops.mkldnn._is_mkldnn_bf16_supported()
