"""Attention between the channels of a picture (transposed attention; Zamir et al. 2022, *Restormer*)."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import torch
from torch import Tensor

from .dispatch import plain

MIN_NORM = 1e-12  # as of `F.normalize`: channels of zeros, and empty pictures, divide by it


@dataclass(frozen=True)
class Sums:
    """The sums over pixels that the attention of a picture needs. Those of its parts add up."""

    products: Tensor  # [B, heads, d, d] Σ q kᵀ
    queries: Tensor  # [B, heads, d, 1] Σ q²
    keys: Tensor  # [B, heads, 1, d] Σ k²

    def __add__(self, other: Sums) -> Sums:
        return Sums(self.products + other.products, self.queries + other.queries, self.keys + other.keys)

    def weights(self, temperature: Tensor) -> Tensor:
        """softmax over the input channels of `temperature` `[heads]` times the cosine of q and k, `[B, heads, d, d]`;
        rows are output channels. float32 or float64."""
        norms = _norm(self.queries) * _norm(self.keys)
        return (temperature.to(norms.dtype).reshape(-1, 1, 1) * self.products / norms).softmax(dim=-1)


def attend_channels(
    q: Tensor,  # [B, C, H, W] queries, C = heads · d
    k: Tensor,  # [B, C, H, W] keys
    v: Tensor,  # [B, C, H, W] values
    temperature: Tensor,  # [heads]
    *,
    heads: int,
    rows: int | None = None,  # pixels are taken in strips of so many rows; None: all at once
) -> Tensor:  # [B, C, H, W]
    """Mix the channels of each head by their likeness over the whole picture:

        a[b,h,i,j]   = softmax_j( temperature[h] · Σ_p q[b,h,i,p] k[b,h,j,p] / (‖q[b,h,i]‖ ‖k[b,h,j]‖) )
        out[b,h,i,p] = Σ_j a[b,h,i,j] · v[b,h,j,p]

    with norms over the pixels p too. Each pixel is mixed by the same matrix, so a permutation of the pixels permutes
    the result. Products and norms are sums over pixels: float32 (float64 with `ops.use("plain")`) whatever the dtype
    of q, k and v, and equal up to rounding however the picture is cut into strips (`sums`, `mix`). Differentiable in
    all tensors. The result has the dtype of `v`.

    Raises ValueError where the shapes do not fit.
    """
    _check(q, k, v, temperature, heads, rows)
    found = None
    for top in range(0, q.shape[2], rows or q.shape[2] or 1):
        strip = slice(top, None if rows is None else top + rows)
        part = sums(q[:, :, strip], k[:, :, strip], heads)
        found = part if found is None else found + part
    return v.clone() if found is None else mix(found.weights(temperature), v)


def sums(q: Tensor, k: Tensor, heads: int) -> Sums:
    """The sums of a picture or a part of it; `q` and `k` as in `attend_channels`."""
    with _as_given(q):
        q, k = (x.to(_dtype(x)).unflatten(1, (heads, -1)).flatten(3) for x in (q, k))
        return Sums(q @ k.mT, q.square().sum(3, keepdim=True), k.square().sum(3).unsqueeze(2))


def mix(weights: Tensor, v: Tensor) -> Tensor:
    """Σ_j weights[b,h,i,j] · v[b,h,j,p], `[B, C, H, W]`: of a picture or a part of it."""
    values = v.unflatten(1, (weights.shape[1], -1)).flatten(3)
    with _as_given(v):
        return (weights.to(values.dtype) @ values).reshape(v.shape)


def _as_given(x: Tensor) -> AbstractContextManager:
    """Without autocast, which rounds the factors of a product to bfloat16."""
    device = x.device.type
    return torch.autocast(device, enabled=False) if device in ("cpu", "cuda") else nullcontext()


def _norm(squares: Tensor) -> Tensor:
    """The root of a sum of squares, with a gradient of zero at zero."""
    return squares.clamp(min=MIN_NORM**2).sqrt()


def _dtype(x: Tensor) -> torch.dtype:
    return torch.float64 if plain() else torch.promote_types(torch.float32, x.dtype)


def _check(q: Tensor, k: Tensor, v: Tensor, temperature: Tensor, heads: int, rows: int | None) -> None:
    if q.ndim != 4 or q.shape != k.shape or q.shape != v.shape:
        raise ValueError(f"expected q, k, v [B, C, H, W], got {', '.join(str(tuple(x.shape)) for x in (q, k, v))}")
    if heads < 1 or q.shape[1] % heads or tuple(temperature.shape) != (heads,):
        raise ValueError(
            f"expected {q.shape[1]} channels in equal heads and a temperature for each, got {heads} heads and a "
            f"temperature {tuple(temperature.shape)}"
        )
    if rows is not None and rows < 1:
        raise ValueError(f"expected strips of 1 row or more, got {rows}")
