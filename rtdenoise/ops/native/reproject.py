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
        B, C, H, W = grad.shape
        found = grad.new_zeros(C, B, H, W)  # whole images of each channel: what is stored may be split anywhere
        run = library("reproject", C=C).reproject_backward
        pointers = map(pointer, (*ctx.saved_tensors, grad.contiguous()))
        run(_planes([found.transpose(0, 1)]), *pointers, B, H, W, *map(c_float, ctx.limits), torch.get_num_threads())
        return (None, *[None] * 5, *(part.transpose(0, 1) for part in found.split(ctx.channels)))


def _forward(limits: tuple[float, ...], where: Sequence[Tensor], stored: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
    stored = [t.contiguous() for t in stored]
    planes = _planes(stored)
    B, _, H, W = where[0].shape
    C = len(planes) // B
    out, valid = torch.empty(B, C, H, W), torch.empty(B, 1, H, W, dtype=torch.bool)
    run = library("reproject", C=C).reproject
    run(planes, *map(pointer, (*where, out, valid)), B, H, W, *map(c_float, limits), torch.get_num_threads())
    return out, valid


def _planes(images: Sequence[Tensor]) -> Sequence[c_void_p]:
    """Where the planes of images `[B, ·, H, W]` begin, those of one picture after another."""
    planes = [plane.data_ptr() for joined in zip(*images, strict=True) for image in joined for plane in image]
    return (c_void_p * len(planes))(*planes)
