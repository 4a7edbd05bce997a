"""The finest detail of a scale taken out of a composed image."""

from __future__ import annotations

from torch import Tensor

from .dispatch import Fused, Support, falls_back
from .downsample import downsample
from .upsample import upsample

FUSED = Fused("soften", native=Support(), triton=Support())


@falls_back
def soften(
    composed: Tensor,  # [B, C, H, W] of `compose`
    fine: Tensor,  # [B, C, H, W] the finer of the two images that were composed
    share: Tensor,  # [B, 1, H, W] in [0, 1]
) -> Tensor:  # [B, C, H, W]
    """Keep a share of the detail that only the finer image has:

        out = composed - (1 - share) · (fine - U[D fine])

    Eq. 4 replaces low frequencies of `fine` and leaves fine - U[D fine] whole, whatever α is. On a flat wall that
    detail is noise: a K×K kernel averages K² samples, and no coarser scale can take the rest out. A share of 1 leaves
    eq. 4 as it is.

    Raises ValueError where the sizes do not fit.
    """
    B, _, H, W = fine.shape
    if composed.shape != fine.shape or share.shape != (B, 1, H, W):
        raise ValueError(
            f"expected composed {tuple(fine.shape)} and share {(B, 1, H, W)} for fine {tuple(fine.shape)}, "
            f"got {tuple(composed.shape)} and {tuple(share.shape)}"
        )
    if run := FUSED(composed=composed, fine=fine, share=share):
        return run(composed, fine, share)
    return composed - (1 - share) * (fine - upsample(downsample(fine), (H, W)))
