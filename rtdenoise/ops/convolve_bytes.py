"""The convolution of a network whose weights and features are bytes: less to move, and four products an instruction."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional as F

from ..errors import NotCompiled
from .dispatch import Fused, Support, compiled, falls_back, plain

FUSED = Fused("convolve_bytes", native=Support(bytes=("x", "below"), other=("below",)))  # channels last only
QUAD = 4  # inputs whose products are summed at once
BLOCK = 32  # outputs: weights are stored for multiples of as many
MOST = 256  # inputs of a picture that the fused op takes


@falls_back
def convolve_bytes(
    x: Tensor,  # [B, C, H, W] uint8, C a multiple of QUAD
    weight: Tensor,  # [P, quads, outputs, QUAD] int8, as `packed` makes them; P is 1, or 4 with `below`
    factor: Tensor,  # [P, O] float32
    bias: Tensor,  # [P, O] float32
    below: Tensor | None = None,  # [B, C', H/2, W/2] uint8, C' a multiple of QUAD
    dtype: torch.dtype = torch.uint8,  # of the result: uint8 or bfloat16
) -> Tensor:  # [B, O, H, W]
    """A 3×3 convolution with zeros around the picture, in whole numbers that are exact, then ReLU:

        out = max(factor[0] · Σ weight · x + bias[0], 0)

    rounded, and at most 255 as bytes. With `below`, a picture of half the size is enlarged by repeating its pixels and
    joined to x before the convolution. A window of 3×3 pixels then covers 2×2 of `below`; each place among the 2×2
    pixels of one below, row first, has weights, factor and bias of its own.
    """
    _check(x, weight, factor, bias, below, dtype)
    count = factor.shape[1]
    taps = (3,) if below is None else (2, 3)
    pictures = [y for y in (below, x) if y is not None]
    channels = [y.shape[1] for y in pictures]
    last = all(y.is_contiguous(memory_format=torch.channels_last) for y in pictures)
    if last and max(channels) <= MOST and (run := FUSED(x=x, below=below)):
        return run(x, weight, factor, bias, below, dtype)
    phases = []
    for phase in range(len(weight)):
        *of_below, of_x = unpacked(weight[phase], channels, taps, count)
        sums = F.conv2d(x.double(), of_x.double(), padding=1)
        if below is not None:
            a, b = divmod(phase, 2)
            around = F.pad(below.double(), (1 - b, b, 1 - a, a))
            sums = F.conv2d(around, of_below[0].double()) + sums[..., a::2, b::2]
        y = sums.float() * factor[phase].double().view(1, -1, 1, 1) + bias[phase].double().view(1, -1, 1, 1)
        y = y.float()
        phases.append(y.clamp(0, 255).round() if dtype == torch.uint8 else y.clamp(min=0))
    if below is not None:
        B, O, H, W = phases[0].shape
        phases = [torch.stack(phases, dim=-1).view(B, O, H, W, 2, 2).transpose(3, 4).reshape(B, O, 2 * H, 2 * W)]
    return phases[0].to(dtype, memory_format=torch.channels_last)


def _check(
    x: Tensor, weight: Tensor, factor: Tensor, bias: Tensor, below: Tensor | None, dtype: torch.dtype
) -> None:
    """Raise ValueError for arguments that do not fit each other: compiled code would read beyond them."""
    if x.ndim != 4 or x.shape[1] % QUAD:
        raise ValueError(f"expected x [B, C, H, W], C a multiple of {QUAD}, got {tuple(x.shape)}")
    phases, quads = (1 if below is None else 4), 9 * x.shape[1] // QUAD
    if below is not None:
        B, _, H, W = x.shape
        if below.ndim != 4 or below.shape[1] % QUAD or [len(below), *(2 * n for n in below.shape[2:])] != [B, H, W]:
            raise ValueError(f"expected below [{B}, C, {H} / 2, {W} / 2], C a multiple of {QUAD}, got "
                             f"{tuple(below.shape)}")  # fmt: skip
        quads += 4 * below.shape[1] // QUAD
    if factor.ndim != 2 or len(factor) != phases or bias.shape != factor.shape:
        raise ValueError(f"expected factor and bias [{phases}, O], got {tuple(factor.shape)} and {tuple(bias.shape)}")
    expected = phases, quads, -(-factor.shape[1] // BLOCK) * BLOCK, QUAD
    if weight.shape != expected:
        raise ValueError(f"expected weight {expected}, got {tuple(weight.shape)}")
    if (found := (weight.dtype, factor.dtype, bias.dtype)) != (torch.int8, torch.float32, torch.float32):
        raise ValueError(f"expected weight, factor and bias of int8, float32 and float32, got {found}")
    if dtype not in (torch.uint8, torch.bfloat16):
        raise ValueError(f"expected a result of uint8 or bfloat16, got {dtype}")


def multiplies_bytes() -> bool:
    """Whether the fused op is there, and this CPU has instructions for its products: AVX512-VNNI, AVX-VNNI or AVX2."""
    if plain() or not compiled("cpu"):
        return False
    from .native.convolve_bytes import multiplies

    try:
        return bool(multiplies())
    except NotCompiled:
        return False


def packed(weights: Sequence[Tensor]) -> Tensor:
    """Weights `[O, C, K, K]` of pictures that are read together, int8, as `[quads, outputs, QUAD]`: tap by tap, four
    inputs a time; zeros for outputs that are not there."""
    parts = []
    for weight in weights:
        O, C, K, _ = weight.shape
        parts.append(weight.permute(2, 3, 1, 0).reshape(K * K * C // QUAD, QUAD, O).transpose(1, 2))
    return F.pad(torch.cat(parts), (0, 0, 0, -parts[0].shape[1] % BLOCK)).contiguous()


def unpacked(weight: Tensor, channels: Sequence[int], taps: Sequence[int], count: int) -> list[Tensor]:
    """Weights `[count, C, K, K]` of each picture from those that `packed` made; `taps` are each K."""
    sizes = [K * K * C // QUAD for C, K in zip(channels, taps, strict=True)]
    return [
        part[:, :count].transpose(1, 2).reshape(K, K, C, count).permute(3, 2, 0, 1)
        for part, C, K in zip(weight.split(sizes), channels, taps, strict=True)
    ]
