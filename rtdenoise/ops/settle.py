"""A picture and the one after it, mixed: what both know of a pixel has other errors in each.

Pictures of single frames differ by blotches that are wider than a pixel, and by blur where one of them was looked up
between pixels. So their difference is taken in two parts (docs/notes/settled.md).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..color import compress, expand
from ..constants import SETTLE_BROAD, SETTLE_BROAD_NEW, SETTLE_FAR, SETTLE_FINE, SETTLE_FINE_NEW
from .dispatch import Fused, Support, falls_back
from .mix import share_told

IMAGES = {"image": (3,), "following": (3,), "noisy": (3,), "alike": (1,), "trusted": (1,)}
FUSED = Fused("settle", native=Support(channels=IMAGES))


@falls_back
def settle(
    image: Tensor,  # [B, 3, H, W] linear radiance, as the next two
    following: Tensor,  # [B, 3, H, W] the picture after it, looked up where each pixel will be
    noisy: Tensor,  # [B, 3, H, W] the frame that `image` is of
    alike: Tensor,  # [B, 1, H, W] in [0, 1]: how far `following` shows the same surface in the same light
    trusted: Tensor,  # [B, 1, H, W] in [0, 1]: how far `image` trusts the picture before it; 0: it has none
    scale: Tensor,  # [B, 1, 1, 1] exposure
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """With f(x) = log(1 + x), exposure s, and means over 3 × 3 pixels:

        w = alike · min(1, t / BROAD)
        d = clamp(f(s · following) - f(s · image), -FAR, FAR),    broad = mean(w d) / mean(w)
        out = f⁻¹(max(0, f(s · image) + w · (a · broad + b · (d - broad)))) / s

    where t is the share of `following` that the noisy frame tells (`mix.share_told`) with BROAD as the usual one: on
    water light does not go with its surface, and where there is little noise the frame tells so. a and b go from
    BROAD_NEW and FINE_NEW, where nothing is `trusted`, to BROAD and FINE (`constants` has them as SETTLE_BROAD ...). To
    the bit the image where nothing is added. No gradients.
    """
    if run := FUSED(image=image, following=following, noisy=noisy, alike=alike, trusted=trusted):
        return run(image, following, noisy, alike, trusted, scale)
    weight = alike * (share_told(noisy, following, image, scale, SETTLE_BROAD) / SETTLE_BROAD).clamp(max=1)
    here = compress(scale * image.clamp(min=0))
    apart = weight * (compress(scale * following.clamp(min=0)) - here).clamp(-SETTLE_FAR, SETTLE_FAR)
    sums = F.avg_pool2d(torch.cat([apart, weight], dim=1), 3, stride=1, padding=1)
    broad = weight * sums[:, :3] / sums[:, 3:].clamp(min=1e-6)
    a = SETTLE_BROAD_NEW + (SETTLE_BROAD - SETTLE_BROAD_NEW) * trusted
    b = SETTLE_FINE_NEW + (SETTLE_FINE - SETTLE_FINE_NEW) * trusted
    change = a * broad + b * (apart - broad)
    return torch.where(change == 0, image, expand((here + change).clamp(min=0)) / scale)
