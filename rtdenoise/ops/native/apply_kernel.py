"""`apply_kernel`, both ways."""

from __future__ import annotations

import ctypes
from ctypes import byref, c_int64

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..logits import in_planes, strides
from .compiler import library, pointer
from .logits import constants, layout, readable


def apply_kernel(image: Tensor, logits: Tensor) -> Tensor:
    if torch.is_grad_enabled() and (image.requires_grad or logits.requires_grad):
        return _ApplyKernel.apply(image, logits)
    return forward(image.contiguous(), readable(logits), None)


class _ApplyKernel(torch.autograd.Function):
    """Keeps two values a pixel (maximum and 1/sum) instead of K² weights, and recomputes the weights in backward."""

    @staticmethod
    def forward(ctx, image: Tensor, logits: Tensor) -> Tensor:
        image, logits = image.contiguous(), _planes(logits)
        stats = image.new_empty(image.shape[0], 2, *image.shape[2:])
        out = forward(image, logits, stats)
        ctx.save_for_backward(image, logits, out, stats)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        image, logits, out, stats = ctx.saved_tensors
        grad, grad_image, grad_logits = grad.contiguous(), None, None
        kernels, (B, _, H, W) = _kernels(image, logits), image.shape
        sizes = B, H, W, c_int64(logits.stride(0)), c_int64(logits.stride(1)), torch.get_num_threads()
        if ctx.needs_input_grad[0]:
            grad_image = torch.empty_like(image)
            kernels.backward_image(*map(pointer, (logits, stats, grad, grad_image)), *sizes)
        if ctx.needs_input_grad[1]:
            grad_logits = image.new_zeros(logits.shape)
            kernels.backward_logits(*map(pointer, (image, logits, out, stats, grad, grad_logits)), *sizes)
            grad_logits = grad_logits.to(logits.dtype)
        return grad_image, grad_logits


def forward(image: Tensor, logits: Tensor, stats: Tensor | None, *blended: Tensor) -> Tensor:
    """`blended` is empty, or the contiguous seen, spatial and alpha of `blend_history`."""
    out, (B, _, H, W) = torch.empty_like(image), image.shape
    pointers = map(pointer, (image, logits, out, stats, *(blended or (None, None, None))))
    _kernels(image, logits).forward(*pointers, B, H, W, byref(layout(logits)), torch.get_num_threads())
    return out


def _kernels(image: Tensor, logits: Tensor) -> ctypes.CDLL:
    return library("apply_kernel", **constants(image, logits))


def _planes(logits: Tensor) -> Tensor:
    """The logits with every plane contiguous."""
    return logits if in_planes(logits) and strides(logits)[3] == logits.shape[3] else logits.contiguous()
