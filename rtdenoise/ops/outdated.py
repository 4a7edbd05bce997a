"""Where light has changed so much that the frames before do not tell of it, and their picture does not either.

Recent frames (`ops.recall`) and running means (`ops.agrees`) are tested against the noise of this frame. Where all
fail, a lamp has gone out, or a shadow has moved on, and the previous picture is not to be blended in
(docs/notes/outdated.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import OUTDATED_CELL, OUTDATED_FRAMES, OUTDATED_RIM


def outdated(
    found: Tensor,  # [B, 1, H, W] bool: the previous frame shows the pixel's surface
    agree: Tensor,  # [B, 1, H, W] ≥ 0: sum of the weights of recent frames (`recall`), or how far their mean `agrees`
    frames: int = 1,  # how many have been asked: 1 for a mean
) -> Tensor:  # [B, 1, H, W] in [0, 1]
    """The share of what was seen before that is outdated:

        share = max(whole, min(near, few))
        whole = 1 - min(1, greatest `agree`)                   over cells of OUTDATED_CELL × OUTDATED_CELL pixels
        near = greatest whole · min(1, Σ whole of the eight around)       of a cell and the eight around
        few = 1 - min(1, greatest `agree` / min(frames, OUTDATED_FRAMES)) over cells of OUTDATED_RIM × OUTDATED_RIM

    where `whole` and `few` are 0 in cells whose surfaces are all new. One frame that agrees with this one is enough for
    0: the test of noise fails by chance, but not for all frames at once. Next to two cells or more in which it did,
    light has changed in a part of a cell, too: there several frames must agree, in a smaller cell.
    """
    H, W = agree.shape[2:]
    some, most = (F.max_pool2d(x.to(agree.dtype), OUTDATED_RIM, ceil_mode=True) for x in (found, agree))
    whole = _share(*(F.max_pool2d(x, OUTDATED_CELL // OUTDATED_RIM, ceil_mode=True) for x in (some, most)))
    sure = whole * (9 * F.avg_pool2d(whole, 3, stride=1, padding=1) - whole).clamp(max=1)
    near = F.max_pool2d(sure, 3, stride=1, padding=1)
    near, whole = (F.interpolate(x, scale_factor=OUTDATED_CELL // OUTDATED_RIM) for x in (near, whole))
    h, w = some.shape[2:]
    rim = near[..., :h, :w].minimum(_share(some, most / min(frames, OUTDATED_FRAMES)))
    return F.interpolate(rim.maximum(whole[..., :h, :w]), scale_factor=OUTDATED_RIM)[..., :H, :W]


def flashed(
    found: Tensor,  # [B, 1, H, W] bool: the previous frame shows the pixel's surface
    agree: Tensor,  # [B, 1, H, W] ≥ 0: weight of the previous frame alone (`recall`)
) -> Tensor:  # [B, 1, H, W] in [0, 1]
    """How far the previous frame alone has other light than this one, as after a flash, whatever older frames say:

        share = min(whole, greatest body of a cell and the eight around)
        body = least whole of a cell and the eight around, but for those whose surfaces are all new

    with `whole` of `outdated`. One frame fails the test of noise by chance, but seldom in so many cells that touch."""
    H, W = agree.shape[2:]
    some, most = (F.max_pool2d(x.to(agree.dtype), OUTDATED_CELL, ceil_mode=True) for x in (found, agree))
    whole = _share(some, most)
    body = -F.max_pool2d(-torch.where(some > 0, whole, 1), 3, stride=1, padding=1)
    share = whole.minimum(F.max_pool2d(body, 3, stride=1, padding=1))
    return F.interpolate(share, scale_factor=OUTDATED_CELL)[..., :H, :W]


def _share(some: Tensor, most: Tensor) -> Tensor:
    return some * (1 - most).clamp(min=0)
