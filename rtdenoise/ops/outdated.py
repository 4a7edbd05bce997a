"""Where light has changed so much that the frames before do not tell of it, and their picture does not either.

Recent frames (`ops.recall`) and running means (`ops.agrees`) are tested against the noise of this frame. Where all
fail, a lamp has gone out, or a shadow has moved on, and the previous picture is not to be blended in
(docs/notes/outdated.md).
"""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F

from ..constants import OUTDATED_CELL


def outdated(
    found: Tensor,  # [B, 1, H, W] bool: the previous frame shows the pixel's surface
    agree: Tensor,  # [B, 1, H, W] ≥ 0: sum of the weights of recent frames (`recall`), or how far their mean `agrees`
) -> Tensor:  # [B, 1, H, W] in [0, 1]
    """The share of what was seen before that is outdated: 1 - min(1, greatest `agree`) over cells of OUTDATED_CELL ×
    OUTDATED_CELL pixels, and 0 in cells whose surfaces are all new. One frame that agrees with this one is enough for
    0: the test of noise fails by chance, but not for all frames at once."""
    H, W = agree.shape[2:]
    some, most = (F.max_pool2d(x.to(agree.dtype), OUTDATED_CELL, ceil_mode=True) for x in (found, agree))
    return F.interpolate(some * (1 - most).clamp(min=0), scale_factor=OUTDATED_CELL)[..., :H, :W]
