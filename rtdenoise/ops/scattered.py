"""Surfaces that one sample a pixel hits here and there, as the lens scatters rays over what is out of focus.

In a blurred lamp one pixel in four or ten shows the lamp, and the others what is behind it. A history that is tested by
what a pixel and those beside it show now would keep the lamp's samples only where it is hit again, and lose its light
(docs/notes/scattered.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import DEPTH_TOLERANCE, SCATTERED_ALIKE, SCATTERED_APART, SCATTERED_REACH
from .dispatch import ON_STACK, Fused, Support, falls_back

FUSED = Fused("scattered", native=Support(max_width=ON_STACK, channels={"depth": (1,)}))


@falls_back
def scattered(depth: Tensor) -> Tensor:  # [B, 1, H, W], 0 where nothing was hit -> [B, 2, H, W]
    """The least and the greatest depth that a sample of a scattered surface around each pixel may have, 1 and 0 where
    there is none.

    They are the extremes of lone samples within SCATTERED_REACH pixels along either axis, by DEPTH_TOLERANCE less and
    more. A sample is alone that hit something, and whose depth is that of SCATTERED_ALIKE of the eight pixels around it
    at most, by DEPTH_TOLERANCE, and they are no more crowded: else it is the end of a line, as a spark, that would
    leave a trail. A border is repeated. There is none where the farthest is SCATTERED_APART times as far as the
    nearest: an object that passed between them would leave a trail, too.

    Raises ValueError where the shape does not fit. No gradients.
    """
    if depth.ndim != 4 or depth.shape[1] != 1:
        raise ValueError(f"expected depth [B, 1, H, W], got {tuple(depth.shape)}")
    if run := FUSED(depth=depth):
        return run(depth)
    crowded = _alike_around(depth, depth) > SCATTERED_ALIKE
    alone = ~crowded & (_alike_around(depth, depth.masked_fill(~crowded, -1)) == 0) & (depth > 0)
    nearest, farthest = (
        F.max_pool2d(torch.where(alone, sign * depth, nothing), 2 * SCATTERED_REACH + 1, 1, SCATTERED_REACH)
        for sign, nothing in ((-1, -torch.inf), (1, 0.0))
    )
    some = farthest <= SCATTERED_APART * -nearest
    some &= farthest > 0
    least, greatest = (1 - DEPTH_TOLERANCE) * -nearest, farthest / (1 - DEPTH_TOLERANCE)
    return torch.cat([torch.where(some, least, 1.0), torch.where(some, greatest, 0.0)], dim=1)


def _alike_around(depth: Tensor, others: Tensor) -> Tensor:
    """How many of the eight pixels around each have its depth in `others`, `[B, 1, H, W]`."""
    H, W = depth.shape[2:]
    padded, alike = F.pad(others, (1, 1, 1, 1), mode="replicate"), torch.zeros_like(depth)
    for k in (0, 1, 2, 3, 5, 6, 7, 8):
        other = padded[..., k // 3 : k // 3 + H, k % 3 : k % 3 + W]
        alike += (other - depth).abs() <= DEPTH_TOLERANCE * torch.maximum(other, depth)
    return alike
