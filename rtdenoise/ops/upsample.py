"""U of eq. 4: ×2, bilinear or nearest."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F


def upsample(
    image: Tensor,  # [B, C, ⌈H/2⌉, ⌈W/2⌉]
    size: tuple[int, int],  # (H, W)
    mode: str = "bilinear",  # or "nearest": out[y, x] = image[⌊y/2⌋, ⌊x/2⌋]
) -> Tensor:  # [B, C, H, W]
    """U of eq. 4: bilinear ×2 on the same geometry as `downsample`.

    Fine pixel x samples the coarse row at u = clamp((x + ½)/2 - ½, 0, ·): weights ¾ and ¼, borders repeated. Odd sizes
    crop the last row or column. Raises ValueError where `size` is not that of the finer level, and for another `mode`.
    """
    if mode not in ("bilinear", "nearest"):
        raise ValueError(f"expected mode 'bilinear' or 'nearest', got {mode!r}")
    H, W = size
    if tuple(image.shape[2:]) != ((H + 1) // 2, (W + 1) // 2):
        raise ValueError(
            f"expected a coarse image of {(H + 1) // 2}×{(W + 1) // 2} for {H}×{W}, got {tuple(image.shape[2:])}"
        )
    aligned = {"align_corners": False} if mode == "bilinear" else {}
    return F.interpolate(image, scale_factor=2, mode=mode, **aligned)[:, :, :H, :W]
