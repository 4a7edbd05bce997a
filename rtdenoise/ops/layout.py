"""How logits lie in memory: what the fused kernels, which are handed pointers and strides, have to know."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F


def whole(logits: Tensor) -> Tensor:
    """Logits of cells, `[B, 2, 2, K², h, w]`, as those of pixels, `[B, K², 2h, 2w]`."""
    B, _, _, N, h, w = logits.shape
    return logits.permute(0, 3, 4, 1, 5, 2).reshape(B, N, 2 * h, 2 * w)


def cells(logits: Tensor) -> Tensor:
    """The inverse of `whole`, of logits `[B, K², H, W]`; an odd size is filled up with zeros."""
    H, W = logits.shape[2:]
    logits = F.pad(logits, (0, W % 2, 0, H % 2)) if H % 2 or W % 2 else logits
    return logits.unflatten(3, (-1, 2)).unflatten(2, (-1, 2)).permute(0, 3, 5, 1, 2, 4)


def strides(logits: Tensor) -> tuple[int, int, int, int, int, int]:
    """Values from one image, tap, row of cells, row, cell and pixel to the next, rows and pixels within their cell of
    2×2; of logits by cells or by pixels."""
    if logits.ndim == 6:
        batch, row, pixel, tap, cell_row, cell = logits.stride()
        return batch, tap, cell_row, row, cell, pixel
    batch, tap, row, pixel = logits.stride()
    pixel = pixel if logits.shape[3] > 1 else 1  # torch may give an axis of one pixel any stride
    return batch, tap, 2 * row, row, 2 * pixel, pixel


def in_planes(logits: Tensor) -> bool:
    """Whether the pixels of a row are neighbours."""
    return strides(logits)[4:] == (2, 1)
