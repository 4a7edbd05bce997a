"""`reproject`, with gradients in the stored images."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import c_float

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ...constants import FAR_AWAY, MIN_HISTORY_WEIGHT
from .compiler import library, planes, pointer


def reproject(
    stored: Sequence[Tensor], motion: Tensor, *geometry: Tensor, tolerances: tuple[float, float]
) -> tuple[Tensor, Tensor]:
    """`geometry` is depth and normal, then those of the previous frame; `tolerances` is that of depth, then of
    normals."""
    where = [t.contiguous() for t in (motion, *geometry)]
    if torch.is_grad_enabled() and any(t.requires_grad for t in stored):
        return _Reproject.apply(tolerances, *where, *stored)
    return _forward(tolerances, where, stored)


class _Reproject(torch.autograd.Function):
    @staticmethod
    def forward(ctx, tolerances: tuple[float, float], *tensors: Tensor) -> tuple[Tensor, Tensor]:
        where, stored = tensors[:5], tensors[5:]
        ctx.save_for_backward(*where)
        ctx.tolerances, ctx.channels = tolerances, [image.shape[1] for image in stored]
        out, valid = _forward(tolerances, where, stored)
        ctx.mark_non_differentiable(valid)
        return out, valid

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor, _) -> tuple[Tensor | None, ...]:
        grad = grad.contiguous()
        grad_stored, (B, C, H, W) = torch.zeros_like(grad), grad.shape
        pointers = map(pointer, (grad_stored, *ctx.saved_tensors, grad))
        _library(C).reproject_backward(*pointers, B, H, W, *map(c_float, ctx.tolerances), torch.get_num_threads())
        return (None, *[None] * 5, *grad_stored.split(ctx.channels, dim=1))


def _forward(
    tolerances: tuple[float, float], where: Sequence[Tensor], stored: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    stored = [t.contiguous() for t in stored]
    B, _, H, W = where[0].shape
    C = sum(t.shape[1] for t in stored)
    out, valid = stored[0].new_empty(B, C, H, W), stored[0].new_empty(B, 1, H, W, dtype=torch.bool)
    pointers = planes(stored), *map(pointer, (*where, out, valid))
    _library(C).reproject(*pointers, B, H, W, *map(c_float, tolerances), torch.get_num_threads())
    return out, valid


def _library(channels: int) -> ctypes.CDLL:
    return library("reproject", C=channels, MIN_HISTORY_WEIGHT=MIN_HISTORY_WEIGHT, FAR_AWAY=FAR_AWAY)
