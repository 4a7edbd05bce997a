"""How the pictures of a kernel network and of one that writes pixels become one: `ops.mix` and its shares.

Kernels lag behind where light has changed: there the written pixels show alone. The image is the history of the next
frame: the kernel network averages it as its own (docs/notes/trust.md).
"""

from __future__ import annotations

from torch import Tensor

from ..constants import MIX_SHARES
from ..ops.evened import held_and_tells
from ..ops.mix import mix as mixture


def mix(
    kernels: Tensor,  # [B, 3, H, W] linear radiance, as the others
    pixels: Tensor,  # [B, 3, H, W]
    scale: Tensor,  # [B, 1, 1, 1] exposure
    trust: Tensor,  # [B, 1, H, W] in [0, 1]
    before: Tensor | None,  # [B, 3, H, W]; None: there is none
    held: Tensor,  # [B, 1, H, W] bool, or numbers in [0, 1]: 0 where motion leads to no previous picture
    shares: tuple[float, float, float] = MIX_SHARES,
    noisy: Tensor | None = None,  # [B, 3, H, W] the frame; None: shares are as they are
) -> Tensor:  # [B, 3, H, W] ≥ 0
    """`ops.mix`. Where a pixel was just uncovered and others around have a history, the noisy frame tells of these, not
    of it."""
    held, tells = (held.to(kernels.dtype), None) if noisy is None else held_and_tells(held, kernels.dtype)
    return mixture(kernels, pixels, scale, trust, shares, before, held, noisy, tells)
