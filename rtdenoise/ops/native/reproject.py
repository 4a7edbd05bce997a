"""Tested reprojection, with gradients in what is looked up."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_float, c_void_p

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .compiler import library, pointer


def reproject(
    stored: Sequence[Tensor], motion: Tensor, *geometry: Tensor, tolerances: tuple[float, float], least: float
) -> tuple[Tensor, Tensor]:
    """`geometry` is depth, normal, depth and normal of the previous frame."""
    limits = (*tolerances, least)
    where = [t.contiguous() for t in (motion, *geometry)]
    if torch.is_grad_enabled() and any(t.requires_grad for t in stored):
        return _Reproject.apply(limits, *where, *stored)
    return _forward(limits, where, stored)


class _Reproject(torch.autograd.Function):
    @staticmethod
    def forward(ctx, limits: tuple[float, ...], *tensors: Tensor) -> tuple[Tensor, Tensor]:
        where, stored = tensors[:5], tensors[5:]
        ctx.save_for_backward(*where)
        ctx.limits, ctx.channels = limits, [image.shape[1] for image in stored]
        out, valid = _forward(limits, where, stored)
        ctx.mark_non_differentiable(valid)
        return out, valid

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor, _) -> tuple[Tensor | None, ...]:
        grad = grad.contiguous()
        found, (B, C, H, W) = torch.zeros_like(grad), grad.shape
        run = library("reproject", C=C).reproject_backward
        pointers = map(pointer, (found, *ctx.saved_tensors, grad))
        run(*pointers, B, H, W, *map(c_float, ctx.limits), torch.get_num_threads())
        return (None, *[None] * 5, *found.split(ctx.channels, dim=1))


def _forward(limits: tuple[float, ...], where: Sequence[Tensor], stored: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    stored = [t.contiguous() for t in stored]
    planes = [plane.data_ptr() for images in zip(*stored, strict=True) for image in images for plane in image]
    B, _, H, W = where[0].shape
    C = len(planes) // B
    out, valid = torch.empty(B, C, H, W), torch.empty(B, 1, H, W, dtype=torch.bool)
    run = library("reproject", C=C).reproject
    pointers = map(pointer, (*where, out, valid))
    run((c_void_p * (B * C))(*planes), *pointers, B, H, W, *map(c_float, limits), torch.get_num_threads())
    return out, valid
