"""Sequences in motion, small enough for a web page: flicker shows there and in no still.

OUT/playback/SEQ/METHOD.webp holds frames one below the other, a window of the picture as it is displayed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from ..color import display
from ..files import replacing

MAX_SIZE = (270, 480)  # of the window, pixels
MAX_FRAMES = 30
QUALITY = 88  # of WebP


def window(masks: list[Tensor]) -> tuple[int, int, int, int]:
    """(top, left, height, width) of the part to play, from the uncovered pixels of every frame `[1, 1, H, W]`: around
    their centre, else the middle of the picture."""
    seen = torch.stack(masks).float().sum((0, 1, 2))
    H, W = seen.shape
    height, width = min(H, MAX_SIZE[0]), min(W, MAX_SIZE[1])
    rows, columns = seen.sum(1), seen.sum(0)
    y, x = (
        float((shares * torch.arange(len(shares))).sum() / shares.sum()) if shares.sum() > 0 else len(shares) / 2
        for shares in (rows, columns)
    )
    return _start(y, height, H), _start(x, width, W), height, width


def shown(
    image: Tensor,  # [1, 3, H, W] linear radiance
    place: tuple[int, int, int, int],  # top, left, height, width
    exposure: float,
) -> np.ndarray:  # [height, width, 3] uint8
    """A frame of a strip, at the exposure that it is displayed at."""
    top, left, height, width = place
    part = display(image[..., top : top + height, left : left + width].float().cpu(), exposure)[0].permute(1, 2, 0)
    return (part.numpy() * 255).round().astype(np.uint8)


def keep_strip(path: Path, frames: list[np.ndarray]) -> None:
    """Write these frames, each as `shown`."""
    strip = np.concatenate(frames)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, ".webp") as temporary:
        Image.fromarray(strip).save(temporary, quality=QUALITY, method=3)


def _start(centre: float, length: int, whole: int) -> int:
    return int(min(max(centre - length / 2, 0), whole - length))
