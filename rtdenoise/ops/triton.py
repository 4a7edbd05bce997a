"""Fused ops for CUDA, in Triton. Same names as in `rtdenoise.ops`, whose functions check the arguments and call these
where they apply (`ops.path`). Sums and weights are float32 whatever the logits are stored in.

A program computes `BLOCK` neighbouring pixels of one row, all channels at once: tiles are [BLOCK] or [BLOCK, CP], CP
the number of channels filled up to a power of two. With TRITON_INTERPRET=1 the same code runs on the CPU, slowly.
"""

from __future__ import annotations

import math

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

from .layout import strides

BLOCK = 128


def unsupported(op: str, *tensors: Tensor) -> str | None:
    """Why `op` cannot take these arguments, or None. Only `apply_kernel` has gradients here."""
    floats = tensors[:1] if op == "apply_kernel" else tensors
    halves = (torch.float32, torch.bfloat16, torch.float16)
    if any(t.dtype != torch.float32 for t in floats) or tensors[-1].dtype not in halves:
        return f"for float32 images, not {', '.join(str(t.dtype).removeprefix('torch.') for t in tensors)}"
    if op != "apply_kernel" and torch.is_grad_enabled() and any(t.requires_grad for t in tensors):
        return "it has no gradient"
    image = tensors[0]
    if image.numel() == 0 or image.shape[2] * image.shape[3] >= 2**31 or math.prod(image.shape[:3]) > 65535:
        return f"not for images of {tuple(image.shape)}"
    return None


@triton.jit
def _place(H, W, BLOCK: tl.constexpr):
    """Image, row and columns of a program, and which of the columns exist."""
    row = tl.program_id(1)
    x = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    return (row // H).to(tl.int64), row % H + tl.zeros([BLOCK], tl.int32), x, x < W


@triton.jit
def _offset(y, x, cell_row, row, cell, step):
    """Of the logits of pixel (y, x), by the strides of `layout.strides`."""
    y, x = y.to(tl.int64), x.to(tl.int64)
    return y // 2 * cell_row + y % 2 * row + x // 2 * cell + x % 2 * step


@triton.jit
def _forward(image, logits, out, stats, H, W, batch, stride, cell_row, row, cell, step, K: tl.constexpr,
             C: tl.constexpr, CP: tl.constexpr, KEEP: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = _place(H, W, BLOCK)
    plane = H.to(tl.int64) * W
    c = tl.arange(0, CP)
    here = logits + b * batch + _offset(y, x, cell_row, row, cell, step)
    most = tl.full([BLOCK], -float("inf"), tl.float32)
    for k in tl.static_range(K * K):
        i, j = y + k // K - K // 2, x + k % K - K // 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        most = tl.maximum(most, tl.load(here + k * stride, mask=inside, other=-float("inf")).to(tl.float32))
    most = tl.where(exists, most, 0.0)
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
    b, y, x, exists = _place(H, W, BLOCK)
    plane = H.to(tl.int64) * W
    c = tl.arange(0, CP)
    pixel = y * W + x
    channels = b * C * plane + c[None, :] * plane
    real = exists[:, None] & (c[None, :] < C)
    g = tl.load(grad + channels + pixel[:, None], mask=real, other=0.0)
    mean = tl.sum(g * tl.load(out + channels + pixel[:, None], mask=real, other=0.0), axis=1)
    most = tl.load(stats + b * 2 * plane + pixel, mask=exists, other=0.0)
    scale = tl.load(stats + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0)
    colour = tl.zeros([BLOCK, CP], tl.float32)
    here = logits + b * batch + _offset(y, x, cell_row, row, cell, step)
    for k in tl.static_range(K * K):
        i, j = y + k // K - K // 2, x + k % K - K // 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        q = i * W + j
        tap = inside[:, None] & (c[None, :] < C)
        v = tl.load(here + k * stride, mask=inside, other=-float("inf")).to(tl.float32)
        dot = tl.sum(g * tl.load(image + channels + q[:, None], mask=tap, other=0.0), axis=1)
        at = grad_logits + (b * K * K + k) * plane + pixel
        tl.store(at, tl.exp(v - most) * scale * (dot - mean), mask=exists)
        there = logits + b * batch + _offset(i, j, cell_row, row, cell, step) + (K * K - 1 - k) * stride
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
    """Keeps two values a pixel (maximum and 1/sum) instead of K² weights, and computes those again on the way back."""

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
        _backward[_grid(image)](
            image,
            logits,
            out,
            stats,
            grad.contiguous(),
            grad_image,
            grad_logits,
            *_layout(image, logits),
            **_shape(image, logits),
        )
        return grad_image, grad_logits.to(logits.dtype)


def _apply(image: Tensor, logits: Tensor, stats: Tensor | None) -> Tensor:
    out = torch.empty_like(image)
    kept = out if stats is None else stats
    sizes = _layout(image, logits)
    _forward[_grid(image)](image, logits, out, kept, *sizes, **_shape(image, logits), KEEP=stats is not None)
    return out


def _grid(image: Tensor) -> tuple[int, int]:
    return triton.cdiv(image.shape[3], BLOCK), image.shape[0] * image.shape[2]


def _layout(image: Tensor, logits: Tensor) -> tuple[int, ...]:
    return *image.shape[2:], *strides(logits)


def _shape(image: Tensor, logits: Tensor) -> dict[str, int]:
    C = image.shape[1]
    return {"K": math.isqrt(logits.shape[-3]), "C": C, "CP": triton.next_power_of_2(C), "BLOCK": BLOCK}


@triton.jit
def _target(motion, x, n):
    """Clamped target of pixel x of n, a motion that is not finite counting as none."""
    finite = tl.abs(motion) <= 3.4028235e38
    return tl.minimum(tl.maximum(tl.where(finite, motion, 0.0) + x, 0.0), n - 1.0)


@triton.jit
def _catmull_rom(f, TAP: tl.constexpr):
    """The weight of pixel x0 - 1 + TAP for a target f beyond x0."""
    if TAP == 0:
        weight = f * (f * (1 - 0.5 * f) - 0.5)
    elif TAP == 1:
        weight = 1 + f * f * (1.5 * f - 2.5)
    elif TAP == 2:
        weight = f * (0.5 + f * (2 - 1.5 * f))
    else:
        weight = f * f * (0.5 * f - 0.5)
    return weight


@triton.jit
def _warp(image, motion, out, H, W, C: tl.constexpr, CP: tl.constexpr, MODE: tl.constexpr, BLOCK: tl.constexpr):
    """`MODE` nearest, bilinear or cubic."""
    b, y, x, exists = _place(H, W, BLOCK)
    plane = H.to(tl.int64) * W
    c = tl.arange(0, CP)
    pixel = y * W + x
    u = _target(tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0), x, W)
    v = _target(tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0), y, H)
    channels = b * C * plane + c[None, :] * plane
    real = exists[:, None] & (c[None, :] < C)
    from_ = image + channels
    x0, y0 = u.to(tl.int32), v.to(tl.int32)
    f, g = (u - x0)[:, None], (v - y0)[:, None]
    if MODE == "nearest":
        at = (v + 0.5).to(tl.int32) * W + (u + 0.5).to(tl.int32)
        result = tl.load(from_ + at[:, None], mask=real, other=0.0)
    elif MODE == "bilinear":
        x1, y1 = tl.minimum(x0 + 1, W - 1), tl.minimum(y0 + 1, H - 1)
        top = tl.load(from_ + (y0 * W + x0)[:, None], mask=real, other=0.0) * (1 - f)
        top += tl.load(from_ + (y0 * W + x1)[:, None], mask=real, other=0.0) * f
        bottom = tl.load(from_ + (y1 * W + x0)[:, None], mask=real, other=0.0) * (1 - f)
        bottom += tl.load(from_ + (y1 * W + x1)[:, None], mask=real, other=0.0) * f
        result = top * (1 - g) + bottom * g
    else:
        least = tl.load(from_ + (y0 * W + x0)[:, None], mask=real, other=0.0)
        greatest = least
        result = tl.zeros([BLOCK, CP], tl.float32)
        for j in tl.static_range(4):
            line = tl.zeros([BLOCK, CP], tl.float32)
            row = tl.minimum(tl.maximum(y0 + j - 1, 0), H - 1) * W
            for i in tl.static_range(4):
                at = row + tl.minimum(tl.maximum(x0 + i - 1, 0), W - 1)
                tap = tl.load(from_ + at[:, None], mask=real, other=0.0)
                line += tap * _catmull_rom(f, i)
                if (i % 3 != 0) and (j % 3 != 0):
                    least, greatest = tl.minimum(least, tap), tl.maximum(greatest, tap)
            result += line * _catmull_rom(g, j)
        result = tl.minimum(tl.maximum(result, least), greatest)
    tl.store(out + channels + pixel[:, None], result, mask=real)


def warp(
    image: Tensor, motion: Tensor, seen: Tensor | None = None, otherwise: Tensor | None = None, cubic: bool = False
) -> Tensor:
    found = _look_up(image, motion, "cubic" if cubic else "bilinear")
    return found if seen is None else torch.where(seen, found, otherwise)


def fetch(image: Tensor, motion: Tensor) -> Tensor:
    return _look_up(image, motion, "nearest")


def _look_up(image: Tensor, motion: Tensor, mode: str) -> Tensor:
    image, motion = image.contiguous(), motion.contiguous()
    out = torch.empty_like(image)
    _warp[_grid(image)](image, motion, out, *image.shape[2:], **_channels(image), MODE=mode)
    return out


def _channels(image: Tensor) -> dict[str, int]:
    return {"C": image.shape[1], "CP": triton.next_power_of_2(image.shape[1]), "BLOCK": BLOCK}


@triton.jit
def _reproject(stored, motion, depth, normal, depth_before, normal_before, out, valid, H, W, depth_tolerance,
               normal_tolerance, least, C: tl.constexpr, CP: tl.constexpr, BLOCK: tl.constexpr):  # fmt: skip
    b, y, x, exists = _place(H, W, BLOCK)
    plane = H.to(tl.int64) * W
    c = tl.arange(0, CP)
    pixel = y * W + x
    channels = b * C * plane + c[None, :] * plane
    mx = tl.load(motion + b * 2 * plane + pixel, mask=exists, other=0.0)
    my = tl.load(motion + (b * 2 + 1) * plane + pixel, mask=exists, other=0.0)
    u = tl.where(mx != mx, 1e6, tl.minimum(tl.maximum(mx, -1e6), 1e6)) + x
    v = tl.where(my != my, 1e6, tl.minimum(tl.maximum(my, -1e6), 1e6)) + y
    left, top = tl.floor(u), tl.floor(v)
    f, g = u - left, v - top
    d = tl.load(depth + b * plane + pixel, mask=exists, other=0.0)
    nx = tl.load(normal + b * 3 * plane + pixel, mask=exists, other=0.0)
    ny = tl.load(normal + (b * 3 + 1) * plane + pixel, mask=exists, other=0.0)
    nz = tl.load(normal + (b * 3 + 2) * plane + pixel, mask=exists, other=0.0)
    total = tl.zeros([BLOCK], tl.float32)
    found = tl.zeros([BLOCK, CP], tl.float32)
    for tap in tl.static_range(4):
        i, j = top.to(tl.int32) + tap // 2, left.to(tl.int32) + tap % 2
        inside = exists & (i >= 0) & (i < H) & (j >= 0) & (j < W)
        at = i * W + j
        wd = tl.load(depth_before + b * plane + at, mask=inside, other=0.0)
        wx = tl.load(normal_before + b * 3 * plane + at, mask=inside, other=0.0)
        wy = tl.load(normal_before + (b * 3 + 1) * plane + at, mask=inside, other=0.0)
        wz = tl.load(normal_before + (b * 3 + 2) * plane + at, mask=inside, other=0.0)
        length = tl.sqrt((nx * nx + ny * ny + nz * nz) * (wx * wx + wy * wy + wz * wz))
        near = tl.abs(d - wd) <= depth_tolerance * tl.maximum(d, wd)
        aligned = nx * wx + ny * wy + nz * wz >= normal_tolerance * length
        hit, was_hit = d > 0, wd > 0
        same = inside & ((hit & was_hit & near & aligned) | (~hit & ~was_hit))
        across = f if tap % 2 else 1 - f
        weight = tl.where(same, across * (g if tap // 2 else 1 - g), 0.0)
        total += weight
        values = tl.load(stored + channels + at[:, None], mask=inside[:, None] & (c[None, :] < C), other=0.0)
        found += weight[:, None] * values
    enough = total >= least
    scale = tl.where(enough, 1 / tl.maximum(total, least), 0.0)
    real = exists[:, None] & (c[None, :] < C)
    tl.store(out + channels + pixel[:, None], found * scale[:, None], mask=real)
    tl.store(valid + b * plane + pixel, enough.to(tl.uint8), mask=exists)


def reproject(
    stored: list[Tensor], motion: Tensor, *geometry: Tensor, tolerances: tuple[float, float], least: float
) -> tuple[Tensor, Tensor]:
    """`geometry` is depth, normal, depth and normal of the previous frame."""
    stored, motion, *geometry = (t.contiguous() for t in (torch.cat(stored, dim=1), motion, *geometry))
    B, _, H, W = stored.shape
    out, valid = torch.empty_like(stored), torch.empty(B, 1, H, W, dtype=torch.uint8, device=stored.device)
    _reproject[_grid(stored)](stored, motion, *geometry, out, valid, H, W, *tolerances, least, **_channels(stored))
    return out, valid.view(torch.bool)


@triton.jit
def _pooled(image, y, x, exists, H, W, MAXIMUM: tl.constexpr):
    """D at the coarse pixel (y, x) of one plane; at an odd border, what there is of the cell."""
    i, j = tl.minimum(2 * y + 1, H - 1), tl.minimum(2 * x + 1, W - 1)  # where the cell is cut off, its own pixel again
    p = tl.load(image + 2 * y * W + 2 * x, mask=exists, other=0.0)
    q = tl.load(image + 2 * y * W + j, mask=exists, other=0.0)
    r = tl.load(image + i * W + 2 * x, mask=exists, other=0.0)
    s = tl.load(image + i * W + j, mask=exists, other=0.0)
    return tl.maximum(tl.maximum(p, q), tl.maximum(r, s)) if MAXIMUM else (p + q + r + s) * 0.25


@triton.jit
def _downsample(image, out, H, W, MAXIMUM: tl.constexpr, BLOCK: tl.constexpr):
    h, w = (H + 1) // 2, (W + 1) // 2
    n, y, x, exists = _place(h, w, BLOCK)
    value = _pooled(image + n * H * W, y, x, exists, H, W, MAXIMUM)
    tl.store(out + n * h * w + y * w + x, value, mask=exists)


def downsample(image: Tensor, pool: str) -> Tensor:
    image = image.contiguous()
    B, C, H, W = image.shape
    out = image.new_empty(B, C, (H + 1) // 2, (W + 1) // 2)
    grid = triton.cdiv(out.shape[3], BLOCK), B * C * out.shape[2]
    _downsample[grid](image, out, H, W, MAXIMUM=pool == "max", BLOCK=BLOCK)
    return out


@triton.jit
def _change(fine, coarse, alpha, y, x, exists, H, W, MAXIMUM: tl.constexpr):
    """alpha · (coarse - D fine) at the coarse pixel (y, x), clamped to what there is."""
    h, w = (H + 1) // 2, (W + 1) // 2
    y, x = tl.minimum(tl.maximum(y, 0), h - 1), tl.minimum(tl.maximum(x, 0), w - 1)
    a = tl.load(alpha + y * w + x, mask=exists, other=0.0)
    return a * (tl.load(coarse + y * w + x, mask=exists, other=0.0) - _pooled(fine, y, x, exists, H, W, MAXIMUM))


@triton.jit
def _compose(fine, coarse, alpha, out, H, W, C: tl.constexpr, MAXIMUM: tl.constexpr, BLOCK: tl.constexpr):
    n, y, x, exists = _place(H, W, BLOCK)  # n: plane
    size = ((H + 1) // 2).to(tl.int64) * ((W + 1) // 2)
    fine += n * H * W
    coarse += n * size
    alpha += n // C * size
    v, u = y // 2, x // 2
    far_v, far_u = v + 2 * (y % 2) - 1, u + 2 * (x % 2) - 1
    near = 0.75 * _change(fine, coarse, alpha, v, u, exists, H, W, MAXIMUM)
    near += 0.25 * _change(fine, coarse, alpha, v, far_u, exists, H, W, MAXIMUM)
    far = 0.75 * _change(fine, coarse, alpha, far_v, u, exists, H, W, MAXIMUM)
    far += 0.25 * _change(fine, coarse, alpha, far_v, far_u, exists, H, W, MAXIMUM)
    value = tl.load(fine + y * W + x, mask=exists, other=0.0) + 0.75 * near + 0.25 * far
    tl.store(out + n * H * W + y * W + x, value, mask=exists)


def compose(fine: Tensor, coarse: Tensor, alpha: Tensor, pool: str) -> Tensor:
    fine, coarse, alpha = fine.contiguous(), coarse.contiguous(), alpha.contiguous()
    B, C, H, W = fine.shape
    out = torch.empty_like(fine)
    grid = triton.cdiv(W, BLOCK), B * C * H
    _compose[grid](fine, coarse, alpha, out, H, W, C=C, MAXIMUM=pool == "max", BLOCK=BLOCK)
    return out
