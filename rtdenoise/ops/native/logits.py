"""The fused ops that read a network's logits: kernels applied, with gradients, pixels picked, and shares of a pixel."""

from __future__ import annotations

import ctypes
import math
from ctypes import byref, c_int64

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..layout import in_planes, strides, whole
from .compiler import library, pointer

LOGITS = {torch.float32: 0, torch.bfloat16: 1, torch.float16: 2}  # LOGIT of logits.h


def apply_kernel(image: Tensor, logits: Tensor) -> Tensor:
    if torch.is_grad_enabled() and (image.requires_grad or logits.requires_grad):
        return _ApplyKernel.apply(image, logits)
    return _forward(image.contiguous(), _readable(logits), None)


class _ApplyKernel(torch.autograd.Function):
    """Keeps two values a pixel (maximum and 1/sum) instead of K² weights, and computes those again on the way back."""

    @staticmethod
    def forward(ctx, image: Tensor, logits: Tensor) -> Tensor:
        image, logits = image.contiguous(), _planes(logits)
        stats = image.new_empty(image.shape[0], 2, *image.shape[2:])
        out = _forward(image, logits, stats)
        ctx.save_for_backward(image, logits, out, stats)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        image, logits, out, stats = ctx.saved_tensors
        grad, grad_image, grad_logits = grad.contiguous(), None, None
        kernels, sizes = _kernels(image, logits), _sizes(image, logits)
        if ctx.needs_input_grad[0]:
            grad_image = torch.empty_like(image)
            kernels.backward_image(*map(pointer, (logits, stats, grad, grad_image)), *sizes)
        if ctx.needs_input_grad[1]:
            grad_logits = torch.zeros(logits.shape)
            kernels.backward_logits(*map(pointer, (image, logits, out, stats, grad, grad_logits)), *sizes)
            grad_logits = grad_logits.to(logits.dtype)
        return grad_image, grad_logits


def blend_history(spatial: Tensor, past: Tensor, seen: Tensor, logits: Tensor, alpha: Tensor) -> Tensor:
    others = [t.contiguous() for t in (seen, spatial, alpha)]
    return _forward(past.contiguous(), _readable(logits), None, *others)


def pick(fine: Tensor, coarse: Tensor, share: Tensor, logits: Tensor) -> Tensor:
    images, logits = [t.contiguous() for t in (fine, coarse, share)], _readable(logits)
    out, (B, _, H, W), layout = torch.empty_like(images[0]), fine.shape, (c_int64 * 6)(*strides(logits))
    run = library("pick", **constants(fine, logits)).pick
    run(*map(pointer, (*images, logits, out)), B, H, W, byref(layout), torch.get_num_threads())
    return out


def _forward(image: Tensor, logits: Tensor, stats: Tensor | None, *blended: Tensor) -> Tensor:
    """`blended` is nothing, or seen, spatial and alpha."""
    out = torch.empty_like(image)
    (B, _, H, W), layout = image.shape, (c_int64 * 6)(*strides(logits))
    pointers = map(pointer, (image, logits, out, stats, *(blended or (None, None, None))))
    _kernels(image, logits).forward(*pointers, B, H, W, byref(layout), torch.get_num_threads())
    return out


def _kernels(image: Tensor, logits: Tensor) -> ctypes.CDLL:
    return library("apply_kernel", **constants(image, logits))


def constants(image: Tensor, logits: Tensor) -> dict[str, int]:
    return {"K": math.isqrt(logits.shape[-3]), "C": image.shape[1], "LOGIT": LOGITS[logits.dtype]}


def _sizes(image: Tensor, logits: Tensor) -> tuple[object, ...]:
    B, _, H, W = image.shape
    return B, H, W, c_int64(logits.stride(0)), c_int64(logits.stride(1)), torch.get_num_threads()


def _planes(logits: Tensor) -> Tensor:
    """With every plane contiguous."""
    return logits if in_planes(logits) and strides(logits)[3] == logits.shape[3] else logits.contiguous()


def _readable(logits: Tensor) -> Tensor:
    """With neighbours along x or along k: planes, channels last and slices of their channels are taken as they are."""
    if in_planes(logits) or strides(logits)[1] == 1 or logits.shape[-3] == 1:
        return logits
    return (whole(logits) if logits.ndim == 6 else logits).contiguous()


def shares(logits: Tensor, size: tuple[int, int]) -> Tensor:
    logits, (B, _, _, N) = _readable(logits), logits.shape[:4]
    out, layout = torch.empty(B, N, *size), (c_int64 * 6)(*strides(logits))
    run = library("shares", N=N, LOGIT=LOGITS[logits.dtype]).shares
    run(pointer(logits), pointer(out), B, *size, byref(layout), torch.get_num_threads())
    return out
