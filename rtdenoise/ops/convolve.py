"""The convolution of a network in float32, and its ReLU, by minimal filtering: half of the products on a CPU."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from .dispatch import Fused, Support, falls_back

FUSED = Fused("convolve", native=Support(other=("below",), channels_last=True))
BLOCK = 32  # outputs: weights are stored for multiples of as many
MOST = 256  # inputs of a picture that the fused op takes


@falls_back
def convolve(
    x: Tensor,  # [B, C, H, W]
    weight: Tensor,  # [O, C' + C, 3, 3]
    bias: Tensor,  # [O]
    of_mixtures: Tensor,  # as `mixed` makes it of the weight
    below: Tensor | None = None,  # [B, C', H/2, W/2]
) -> Tensor:  # [B, O, H, W]
    """A 3×3 convolution with zeros around the picture, then ReLU. With `below`, a picture of half the size is enlarged
    by repeating its pixels and joined to x before the convolution: its channels are the first of the weight."""
    last = all(y is None or y.is_contiguous(memory_format=torch.channels_last) for y in (x, below))
    if last and _fits(x, below) and (run := FUSED(x=x, below=below)):
        return run(x, weight, bias, of_mixtures, below)
    if below is not None:
        x = torch.cat([F.interpolate(below, scale_factor=2, mode="nearest"), x], dim=1)
    return F.relu(F.conv2d(x, weight, bias, padding=1))


def _fits(x: Tensor, below: Tensor | None) -> bool:
    B, C, H, W = x.shape
    if below is not None and (below.shape[1] > MOST or [len(below), *(2 * n for n in below.shape[2:])] != [B, H, W]):
        return False
    return C <= MOST


def mixed(weight: Tensor, below: int = 0) -> Tensor:
    """Weights `[O, C' + C, 3, 3]`, C' of them `below`, as minimal filtering multiplies them: `[rows, outputs]`, for
    each of its 16 sums a row for each input, those of x first; zeros for outputs that are not there.

    Winograd's F(2×2, 3×3) (Lavin and Gray 2016) multiplies mixtures of 4×4 inputs with these. Enlarged by repeating its
    pixels, a picture has none in the third place of a row or a column.
    """
    of_x = weight.new_tensor([[1, 0, 0], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0, 0, 1]], dtype=torch.float64)
    of_below = weight.new_tensor([[1, 0, 0], [1, 1, 1], [0, 0, 0], [0, 0, 1]], dtype=torch.float64)
    coarse, fine = weight.detach().double().split([below, weight.shape[1] - below], dim=1)
    coarse, fine = (torch.einsum("vy,oiyx,ux->vuio", m, w, m) for m, w in ((of_below, coarse), (of_x, fine)))
    rows = [part[v, u] for v in range(4) for u in range(4) for part in ((fine,) if 2 in (v, u) else (fine, coarse))]
    rows = torch.cat(rows).to(weight.dtype)
    return F.pad(rows, (0, -rows.shape[1] % BLOCK)).contiguous()
