"""Eq. 4: two scales of the image pyramid combined."""

from __future__ import annotations

from torch import Tensor

from .dispatch import Fused, Support, falls_back
from .downsample import downsample
from .upsample import upsample

FUSED = Fused("compose", native=Support(other=("coarse", "alpha")), triton=Support(other=("coarse", "alpha")))


@falls_back
def compose(
    fine: Tensor,  # [B, C, H, W] filtered at this scale
    coarse: Tensor,  # [B, C, ⌈H/2⌉, ⌈W/2⌉] filtered and composed at the next coarser one
    alpha: Tensor,  # [B, 1, ⌈H/2⌉, ⌈W/2⌉] in [0, 1], on the coarse grid
    pool: str = "mean",
) -> Tensor:  # [B, C, H, W]
    """Replace a share α of the low frequencies of `fine` by those of `coarse` (eq. 4, after Vogels et al. 2018):

        out = fine - U[α · D fine] + U[α · coarse]

    With pool "nearest" U is nearest too. Raises ValueError where the sizes do not fit, and for another `pool`.
    """
    B, C, H, W = fine.shape
    expected = (B, C, (H + 1) // 2, (W + 1) // 2)
    if coarse.shape != expected or alpha.shape != (B, 1, *expected[2:]):
        raise ValueError(
            f"expected coarse {expected} and alpha {(B, 1, *expected[2:])} for fine {tuple(fine.shape)}, "
            f"got {tuple(coarse.shape)} and {tuple(alpha.shape)}"
        )
    if pool in ("mean", "max") and (run := FUSED(fine=fine, coarse=coarse, alpha=alpha)):
        return run(fine, coarse, alpha, pool)
    mode = "nearest" if pool == "nearest" else "bilinear"
    return fine + upsample(alpha * (coarse - downsample(fine, pool)), (H, W), mode)
