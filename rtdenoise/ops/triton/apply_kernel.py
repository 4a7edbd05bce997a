"""`apply_kernel`, both ways."""

from __future__ import annotations

import math

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..logits import strides
from .common import constants, grid, place
from .logits import greatest, offset


@triton.jit
def _forward(image, logits, out, stats, H, W, batch, stride, cell_row, row, cell, step, K: tl.constexpr,
             C: tl.constexpr, CP: tl.constexpr, KEEP: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = place(H, W, BLOCK)
    plane, stride = tl.cast(H, tl.int64) * W, tl.cast(stride, tl.int64)
    c = tl.arange(0, CP)
    here = logits + b * batch + offset(y, x, cell_row, row, cell, step)
    most = greatest(here, y, x, exists, H, W, stride, K)
    total = tl.zeros([BLOCK], tl.float32)
    colour = tl.zeros([BLOCK, CP], tl.float32)
    for k in tl.static_range(K * K):
        i, j = y + k // K - K // 2, x + k % K - K // 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        w = tl.exp(tl.load(here + k * stride, mask=inside, other=-float("inf")).to(tl.float32) - most)
        total += w
        at = image + b * C * plane + c[None, :] * plane + (i * W + j)[:, None]
        colour += w[:, None] * tl.load(at, mask=inside[:, None] & (c[None, :] < C), other=0.0)
    scale = tl.where(exists, 1 / total, 0.0)
    pixel = y * W + x
    at = out + b * C * plane + c[None, :] * plane + pixel[:, None]
    tl.store(at, colour * scale[:, None], mask=exists[:, None] & (c[None, :] < C))
    if KEEP:
        tl.store(stats + b * 2 * plane + pixel, most, mask=exists)
        tl.store(stats + (b * 2 + 1) * plane + pixel, scale, mask=exists)


@triton.jit
def _backward(image, logits, out, stats, grad, grad_image, grad_logits, H, W, batch, stride, cell_row, row, cell, step,
              K: tl.constexpr, C: tl.constexpr, CP: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    """Both gradients of one pixel: grad_logits[k] = w[k] · (grad · image[tap k] - grad · out), and grad_image gathered
    from the pixels q that read this one, each with its opposite tap."""
    b, y, x, exists = place(H, W, BLOCK)
    plane, stride = tl.cast(H, tl.int64) * W, tl.cast(stride, tl.int64)
    c = tl.arange(0, CP)
    pixel = y * W + x
    channels = b * C * plane + c[None, :] * plane
    real = exists[:, None] & (c[None, :] < C)
    g = tl.load(grad + channels + pixel[:, None], mask=real, other=0.0)
    mean = tl.sum(g * tl.load(out + channels + pixel[:, None], mask=real, other=0.0), axis=1)
    most = tl.load(stats + b * 2 * plane + pixel, mask=exists, other=0.0)
    scale = tl.load(stats + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0)
    colour = tl.zeros([BLOCK, CP], tl.float32)
    here = logits + b * batch + offset(y, x, cell_row, row, cell, step)
    for k in tl.static_range(K * K):
        i, j = y + k // K - K // 2, x + k % K - K // 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        q = i * W + j
        tap = inside[:, None] & (c[None, :] < C)
        v = tl.load(here + k * stride, mask=inside, other=-float("inf")).to(tl.float32)
        dot = tl.sum(g * tl.load(image + channels + q[:, None], mask=tap, other=0.0), axis=1)
        at = grad_logits + (b * K * K + k) * plane + pixel
        tl.store(at, tl.exp(v - most) * scale * (dot - mean), mask=exists)
        there = logits + b * batch + offset(i, j, cell_row, row, cell, step) + (K * K - 1 - k) * stride
        w = tl.exp(tl.load(there, mask=inside, other=-float("inf")).to(tl.float32)
                   - tl.load(stats + b * 2 * plane + q, mask=inside, other=0.0))  # fmt: skip
        w *= tl.load(stats + (b * 2 + 1) * plane + q, mask=inside, other=0.0)
        colour += w[:, None] * tl.load(grad + channels + q[:, None], mask=tap, other=0.0)
    tl.store(grad_image + channels + pixel[:, None], colour, mask=real)


def apply_kernel(image: Tensor, logits: Tensor) -> Tensor:
    if torch.is_grad_enabled() and (image.requires_grad or logits.requires_grad):
        return _ApplyKernel.apply(image, logits)
    return _apply(image.contiguous(), logits, None)


class _ApplyKernel(torch.autograd.Function):
    """Keeps two values a pixel (maximum and 1/sum) instead of K² weights, and recomputes the weights in backward."""

    @staticmethod
    def forward(ctx, image: Tensor, logits: Tensor) -> Tensor:
        image = image.contiguous()
        stats = image.new_empty(image.shape[0], 2, *image.shape[2:])
        out = _apply(image, logits, stats)
        ctx.save_for_backward(image, logits, out, stats)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor]:
        image, logits, out, stats = ctx.saved_tensors
        grad_image, grad_logits = torch.empty_like(image), image.new_empty(logits.shape)
        tensors = image, logits, out, stats, grad.contiguous(), grad_image, grad_logits
        _launch(_backward, image, logits, tensors)
        return grad_image, grad_logits.to(logits.dtype)


def _apply(image: Tensor, logits: Tensor, stats: Tensor | None) -> Tensor:
    out = torch.empty_like(image)
    kept = out if stats is None else stats
    _launch(_forward, image, logits, (image, logits, out, kept), KEEP=stats is not None)
    return out


def _launch(kernel, image: Tensor, logits: Tensor, tensors: tuple[Tensor, ...], **more: bool) -> None:
    B, C, H, W = image.shape
    K = math.isqrt(logits.shape[-3])
    kernel[grid(B, H, W)](*tensors, H, W, *strides(logits), K=K, **constants(C), **more)
