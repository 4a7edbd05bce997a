"""`warp`, with gradients in the image."""

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
        return _forward(taps, image, motion, seen, otherwise)
    found = _Warp.apply(image.contiguous(), motion.contiguous(), taps)
    return found if seen is None else torch.where(seen, found, otherwise)


class _Warp(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image: Tensor, motion: Tensor, taps: int) -> Tensor:
        ctx.save_for_backward(image, motion)
        ctx.taps = taps
        return _forward(taps, image, motion, None, None)

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, None, None]:
        image, motion = ctx.saved_tensors
        grad, grad_image, (B, C, H, W) = grad.contiguous(), torch.zeros_like(image), image.shape
        run = library("warp", C=C, TAPS=ctx.taps).warp_backward
        run(*map(pointer, (grad_image, image, motion, grad)), B, H, W, torch.get_num_threads())
        return grad_image, None, None


def _forward(taps: int, image: Tensor, motion: Tensor, *choice: Tensor | None) -> Tensor:
    """`choice` is seen and otherwise, or None twice."""
    image, motion, *choice = (t if t is None else t.contiguous() for t in (image, motion, *choice))
    out, (B, C, H, W) = torch.empty_like(image), image.shape
    pointers = map(pointer, (image, motion, *choice, out))
    library("warp", C=C, TAPS=taps).warp(*pointers, B, H, W, torch.get_num_threads())
    return out
