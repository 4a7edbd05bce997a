"""Apply a predicted kernel at every pixel: the operation that the whole denoiser is built around."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn import functional as F

from .dispatch import Fused, Support, falls_back, transformed
from .logits import whole

MAX_KERNEL = 7  # C is unrolled over K² taps: it compiles for 11 s at 7, 43 s at 15
LOGITS = ("logits",)
FUSED = Fused(
    "apply_kernel",
    native=Support(max_channels=8, max_kernel=MAX_KERNEL, halves=LOGITS, other=LOGITS, gradients=("image", "logits")),
    triton=Support(max_kernel=MAX_KERNEL, halves=LOGITS, other=LOGITS, gradients=("image", "logits")),
)


@falls_back
def apply_kernel(
    image: Tensor,  # [B, C, H, W]
    logits: Tensor,  # [B, K², H, W], K odd, or by cells: [B, 2, 2, K², ⌈H/2⌉, ⌈W/2⌉]
) -> Tensor:  # [B, C, H, W]
    """Filter every pixel with its own softmax-normalised K×K kernel (Bako et al. 2017; the paper, §4.3).

        w[b,k,y,x]   = softmax_k logits[b,k,y,x], over the taps k = dy·K + dx that lie inside the image
        out[b,c,y,x] = Σ_{dy,dx ∈ 0..K-1} w[b, dy·K+dx, y, x] · image[b, c, y+dy-r, x+dx-r],    r = ⌊K/2⌋

    It gathers. Weights are positive and sum to 1, at borders too: a constant image stays as it is, the output lies
    between the least and the greatest tap, and grey stays grey. Softmax subtracts the maximum and accumulates in
    float32 (or float64) whatever the dtype of `logits`; the result has the dtype of `image`. Fused ops and shaders
    divide by the sum of the weights at the end: images beyond 3.4e38 / K² may overflow in them.

    A network at half size predicts logits by cells, for all four pixels of a 2×2 cell at once: the logits of pixel
    (y, x) are logits[b, y mod 2, x mod 2, :, ⌊y/2⌋, ⌊x/2⌋].

    Raises ValueError for what is no tensor, where the shapes do not fit, the image holds no floats, or K is even.
    """
    check(image, logits)
    H, W = image.shape[2:]
    if logits.ndim == 6 and torch.is_grad_enabled() and (image.requires_grad or logits.requires_grad):
        logits = whole(logits)[:, :, :H, :W]
    if run := FUSED(image=image, logits=logits):
        return run(image, logits)

    K = math.isqrt(logits.shape[-3])
    logits = whole(logits)[:, :, :H, :W] if logits.ndim == 6 else logits
    dtype = torch.promote_types(torch.float32, image.dtype)
    weights = logits.to(dtype).masked_fill(~_inside(H, W, K, logits.device), -math.inf).softmax(dim=1)
    padded = F.pad(image.to(dtype), [K // 2] * 4)
    if transformed(weights, padded):
        return sum(weights[:, k : k + 1] * window for k, window in _windows(padded, K)).to(image.dtype)
    return _Gather.apply(weights, padded, K).to(image.dtype)


def check(image: Tensor, logits: Tensor) -> None:
    """Raise ValueError where `apply_kernel` does."""
    if not (isinstance(image, Tensor) and isinstance(logits, Tensor)):
        raise ValueError(f"expected tensors, got {type(image).__name__} and {type(logits).__name__}")
    if image.ndim != 4 or logits.ndim not in (4, 6):
        raise ValueError(f"expected image and logits [B, C, H, W], got {tuple(image.shape)} and {tuple(logits.shape)}")
    B, _, H, W = image.shape
    K = math.isqrt(logits.shape[-3])
    cells = (B, 2, 2, K**2, (H + 1) // 2, (W + 1) // 2)
    if K % 2 == 0 or tuple(logits.shape) not in ((B, K**2, H, W), cells):
        raise ValueError(f"expected logits [{B}, K², {H}, {W}] with K odd, got {tuple(logits.shape)}")
    if not image.is_floating_point():
        raise ValueError(f"expected an image of floats, got {image.dtype}")


class _Gather(torch.autograd.Function):
    """The weighted sum over taps. Its backward is written out because autograd would keep and zero a full-size buffer
    for every tap."""

    @staticmethod
    def forward(ctx, weights: Tensor, padded: Tensor, K: int) -> Tensor:
        ctx.save_for_backward(weights, padded)
        ctx.K = K
        out = padded.new_zeros(padded.shape[0], padded.shape[1], *weights.shape[2:])
        for k, window in _windows(padded, K):
            out.addcmul_(weights[:, k : k + 1], window)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad: Tensor) -> tuple[Tensor, Tensor, None]:
        weights, padded = ctx.saved_tensors
        grad_weights, grad_padded = torch.empty_like(weights), torch.zeros_like(padded)
        for (k, window), (_, grad_window) in zip(_windows(padded, ctx.K), _windows(grad_padded, ctx.K), strict=True):
            grad_weights[:, k] = (grad * window).sum(dim=1)
            grad_window.addcmul_(weights[:, k : k + 1], grad)
        return grad_weights, grad_padded, None


def _windows(padded: Tensor, K: int) -> Iterator[tuple[int, Tensor]]:
    """(k, the padded image shifted to tap k) for every tap; each image is a view `[B, C, H, W]`."""
    H, W = padded.shape[2] - K + 1, padded.shape[3] - K + 1
    for dy in range(K):
        for dx in range(K):
            yield dy * K + dx, padded[:, :, dy : dy + H, dx : dx + W]


def _inside(H: int, W: int, K: int, device: torch.device) -> Tensor:
    """Whether each tap lies inside the image, `[1, K², H, W]` bool."""
    offset = torch.arange(K, device=device) - K // 2
    y = torch.arange(H, device=device) + offset[:, None]  # [K, H] row of tap dy
    x = torch.arange(W, device=device) + offset[:, None]  # [K, W] column of tap dx
    rows, columns = (y >= 0) & (y < H), (x >= 0) & (x < W)
    return (rows[:, None, :, None] & columns[None, :, None, :]).reshape(1, K * K, H, W)
