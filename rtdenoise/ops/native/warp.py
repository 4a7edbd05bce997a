"""Reprojection, with gradients in what is looked up."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .compiler import library, pointer


def warp(
    image: Tensor, motion: Tensor, seen: Tensor | None = None, otherwise: Tensor | None = None, cubic: bool = False
) -> Tensor:
    taps = 4 if cubic else 2
    if not (torch.is_grad_enabled() and image.requires_grad):
        return _look_up("warp", taps, image, motion, seen, otherwise)
    found = _Warp.apply(image.contiguous(), motion.contiguous(), taps)
    return found if seen is None else torch.where(seen, found, otherwise)


def fetch(image: Tensor, motion: Tensor) -> Tensor:
    return _look_up("fetch", 2, image, motion)


class _Warp(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image: Tensor, motion: Tensor, taps: int) -> Tensor:
        ctx.save_for_backward(image, motion)
        ctx.taps = taps
        return _look_up("warp", taps, image, motion, None, None)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None, None]:
        image, motion = ctx.saved_tensors
        grad, found, (B, C, H, W) = grad.contiguous(), torch.zeros_like(image), image.shape
        run = library("warp", C=C, TAPS=ctx.taps).warp_backward
        run(*map(pointer, (found, image, motion, grad)), B, H, W, torch.get_num_threads())
        return found, None, None


def _look_up(name: str, taps: int, *tensors: Tensor | None) -> Tensor:
    """The first of the tensors is looked up."""
    tensors = [t if t is None else t.contiguous() for t in tensors]
    B, C, H, W = tensors[0].shape
    out = torch.empty_like(tensors[0])
    getattr(library("warp", C=C, TAPS=taps), name)(*map(pointer, (*tensors, out)), B, H, W, torch.get_num_threads())
    return out
