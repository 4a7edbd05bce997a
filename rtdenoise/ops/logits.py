"""The memory layouts of logits: by pixels and by cells of 2×2 pixels."""

from __future__ import annotations

from torch import Tensor
from torch.nn import functional as F


def whole(logits: Tensor) -> Tensor:
    """Logits by cells, `[B, 2, 2, K², h, w]`, as logits by pixels, `[B, K², 2h, 2w]`. Inverse: `cells`."""
    B, _, _, N, h, w = logits.shape
    return logits.permute(0, 3, 4, 1, 5, 2).reshape(B, N, 2 * h, 2 * w)


def cells(logits: Tensor) -> Tensor:
    """Logits by pixels, `[B, K², H, W]`, as logits by cells; odd sizes are padded with zeros. Inverse: `whole`."""
    H, W = logits.shape[2:]
    logits = F.pad(logits, (0, W % 2, 0, H % 2)) if H % 2 or W % 2 else logits
    return logits.unflatten(3, (-1, 2)).unflatten(2, (-1, 2)).permute(0, 3, 5, 1, 2, 4)


def strides(logits: Tensor) -> tuple[int, int, int, int, int, int]:
    """Strides, in values, of logits by cells or by pixels: (image, tap, row of cells, row in a cell, cell, pixel in a
    cell)."""
    if logits.ndim == 6:
        batch, row, pixel, tap, cell_row, cell = logits.stride()
        return batch, tap, cell_row, row, cell, pixel
    batch, tap, row, pixel = logits.stride()
    pixel = pixel if logits.shape[3] > 1 else 1  # torch may give an axis of one pixel any stride
    return batch, tap, 2 * row, row, 2 * pixel, pixel


def in_planes(logits: Tensor) -> bool:
    """Whether neighbouring pixels of a row are neighbours in memory."""
    return strides(logits)[4:] == (2, 1)
