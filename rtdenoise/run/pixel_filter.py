"""The networks of `hybrid-large` that write pixels, as a filter of single pictures, like `baselines.oidn`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..exposure import exposure
from ..frame import Frame
from ..models.config import CELL
from ..models.loading import load
from ..models.pixel_network import written

MODEL = "hybrid-large"
AROUND = 5  # pixels of that mean along either axis
TILE = 1024  # pixels, a multiple of `CELL`: larger pictures are filtered in tiles, so that memory is bounded


class PixelFilter:
    """Steps of bytes and bfloat16 show where little noise is left; hence float32."""

    def __init__(self, device: str | torch.device = "cpu", precision: str = "fp32") -> None:
        network = load(MODEL, device, precision)
        self._network, self._reach = network.pixels, network.config.pixels.reach

    @torch.no_grad()
    def prefiltered(self, frame: Frame) -> Frame:
        """The (sanitised) frame with its albedo and normal without noise, each filtered by itself."""
        albedo, normal = in_tiles(self._network.clean, self._reach, frame.albedo, frame.normal)
        return replace(frame, albedo=albedo, normal=normal)

    @torch.no_grad()
    def step(self, frame: Frame) -> tuple[Tensor, None]:
        """The radiance of a (sanitised) frame with clean albedo and normal, without noise and within the light around
        each pixel, `[1, 3, H, W]`; there is no history."""

        def write(lit: Tensor) -> Tensor:
            return in_tiles(lambda *x: (self._network.write(*x),), self._reach, lit, frame.albedo, frame.normal)[0]

        other = frame.radiance
        if self._network.greatest < math.inf:  # in bytes: of light beyond a mean shows
            other = F.avg_pool2d(other, AROUND, stride=1, padding=AROUND // 2, count_include_pad=False)
        return written(write, frame.radiance, other, exposure(frame.radiance), self._network.greatest), None


def in_tiles(run: Callable[..., tuple[Tensor, ...]], reach: int, *layers: Tensor) -> tuple[Tensor, ...]:
    """`run(*layers)`, tile by tile; an output pixel depends on input within `reach` pixels."""
    H, W = layers[0].shape[2:]
    if max(H, W) <= TILE:
        return run(*layers)
    margin, outputs = -(-reach // CELL) * CELL, ()
    for top in range(0, H, TILE):
        for left in range(0, W, TILE):
            y, x = max(0, top - margin), max(0, left - margin)
            tile = np.s_[..., y : top + TILE + margin, x : left + TILE + margin]
            parts = run(*(layer[tile] for layer in layers))
            outputs = outputs or tuple(part.new_empty(*part.shape[:2], H, W) for part in parts)
            for whole, part in zip(outputs, parts, strict=True):
                core = part[..., top - y :, left - x :][..., :TILE, :TILE]
                whole[..., top : top + TILE, left : left + TILE] = core
    return outputs
