"""What the residuals y - z of a window tell of errors of z: inputs of a combiner, and the share of a correction that it
begins with (`models.combiner`)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..frame import Frame
from .shrinkage import agreement, edges, few_samples
from .window import Aligned, box

STATISTICS = (5, 15)  # sides in pixels of the neighbourhoods over which residuals are averaged
LEAST = 0.02  # share of a correction that nothing supports
MAX_MORE, MAX_LESS = 0.3, 8.0  # by which the network raises or lowers the share's logit
MAX_MORE_IN_TRAINING = 1.0  # less in use: a margin for other scenes (docs/notes/combiner_training.md)
MIN_VARIANCE = 1e-8  # of residuals, so that none is divided by zero


def signed_log(x: Tensor) -> Tensor:
    """sign(x) · log(1 + |x|): `color.compress` for values of either sign."""
    return x.sign() * x.abs().log1p()


def evidence(
    residuals: Sequence[Tensor | None],  # [B, 3, h, w] of every frame, zero where it is not valid
    valid: Sequence[Tensor | None],  # [B, 1, h, w] in [0, 1]
    current: int,
    believed: Tensor,  # [B, 1, h, w] in [0, 1]: `one_surface`
) -> Tensor:  # [B, 1, h, w], between those of LEAST and 1 - LEAST; -inf without other frames
    """The logit of `shrinkage`'s share: how far the current frame and the mean of the others agree that z is wrong."""
    own = residuals[current]
    others = [j for j, one in enumerate(residuals) if one is not None and j != current]
    if not others:
        return torch.full_like(own[:, :1], -torch.inf)
    count = sum(valid[j] for j in others)
    mean = sum(residuals[j] for j in others) / count.clamp(min=1e-6)
    usable = ((count > 0.5) & (believed > 0.5)).to(own.dtype)
    return agreement(own, mean, count, usable).clamp(LEAST, 1 - LEAST).logit()


def bounded(change: Tensor, training: bool = False) -> Tensor:
    """`change` within `MAX_MORE` above and `MAX_LESS` below; its own near 0."""
    bound = torch.where(change > 0, MAX_MORE_IN_TRAINING if training else MAX_MORE, MAX_LESS)
    return bound * (change / bound).tanh()


def one_surface(frame: Frame) -> Tensor:
    """1 where the noisy light of a pixel is that of one surface or of many samples, else 0, `[B, 1, H, W]`: at an edge
    a few samples of several frames agree although z is right (`shrinkage.edges`)."""
    return (~(edges(frame) & few_samples(frame))).to(frame.depth.dtype)


def certainty(frame: Frame) -> Tensor:
    """log(samples) / 4, `[B, 1, H, W]`: 0 for one sample a pixel, and for an unknown number."""
    if frame.samples is None:
        return torch.zeros_like(frame.depth)
    return 0.25 * torch.nan_to_num(frame.samples, nan=1.0).clamp(1, 1e4).log().expand_as(frame.depth)


def statistics(aligned: Sequence[Aligned]) -> Tensor:  # [B, 13, H, W]
    """Evidence in the residuals for an error of z. Over each neighbourhood of `STATISTICS`, all frames together: their
    mean m (3 channels) and m divided by its standard error (3), compressed. Then the log of their variance (1)."""
    first, second = sum(one.residual for one in aligned), sum(one.residual.square() for one in aligned)
    channels, frames = [], sum(one.valid for one in aligned)
    for side in STATISTICS:
        count = side**2 * box(frames, side).clamp(min=1 / side**2)
        mean, square = (side**2 * box(x, side) / count for x in (first, second))
        channels += [signed_log(mean), torch.asinh(mean * (count / (square + MIN_VARIANCE)).sqrt())]
    variance = box(second, STATISTICS[0]).mean(1, keepdim=True)
    return torch.cat([*channels, 0.25 * (variance + MIN_VARIANCE).log()], dim=1)
