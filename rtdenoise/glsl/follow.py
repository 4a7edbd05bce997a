"""Light that moves otherwise than its surfaces, in mirrors and behind glass: `rtdenoise.shift` as passes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..constants import (
    BRIGHTNESS_BLOCK,
    SHIFT_BLOCK,
    SHIFT_CELL,
    SHIFT_DAMPING,
    SHIFT_LIGHT_CELL,
    SHIFT_LIGHT_DAMPING,
    SHIFT_ROUNDS,
    SHIFT_STRIDE,
)
from .context import GpuArray
from .dispatch import BLOCK_GROUP, SELECT_GROUP, dispatch, fill
from .scratch import Scratch
from .state import History

if TYPE_CHECKING:
    from .passes import Inputs


class Follow:
    """The passes that find how light has moved, and add it to motion."""

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch

    def surfaces(self, inputs: Inputs, noisy: GpuArray) -> tuple[GpuArray, GpuArray]:
        """Light and depth of each block; and the blocks in and beside which there is one surface."""
        (H, W), extent = inputs.surface.shape[:2], _cells(inputs.surface.shape, SHIFT_BLOCK)
        blocks = self._scratch.image("shift.blocks", extent)
        buffers = {"picture": noisy, "surface": inputs.surface, "blocks": blocks}
        dispatch("shift/blocks", extent[::-1], buffers, {"image_size": (W, H)})
        return blocks, self._near("flat", blocks)

    def shift(
        self,
        inputs: Inputs,
        surfaces: tuple[GpuArray, GpuArray],  # of this frame, as the next
        vectors: GpuArray,
        noisy: GpuArray,
        noisy_before: GpuArray,
        surface_before: GpuArray,
        told: tuple[GpuArray, ...],  # the shifts that the frame before agreed on, if there are any
    ) -> GpuArray:
        """How far light has moved over its surfaces, [H, W] pixels: `models.moved_light.shift_of`."""
        scratch, surface = self._scratch, inputs.surface
        size = surface.shape[1::-1]
        moved, edges = scratch.image("shift.moved", surface.shape[:2]), scratch("shift.edges", (1,), np.uint32)
        fill(edges)
        (blocks, flat), near = surfaces, self._near("even", surfaces[0])
        (told,) = told or (self.nothing(surface.shape),)
        buffers = {"told": told, "vectors": vectors, "flat_blocks": flat, "moved": moved}
        dispatch("shift/told", size, buffers, CELL=SHIFT_CELL)
        pictures = noisy, noisy_before, surface_before
        shift = self._displacement(pictures, inputs, vectors, near, SHIFT_LIGHT_CELL, SHIFT_LIGHT_DAMPING, blur=True)
        buffers = {"shift": shift, "near": near, "blocks": blocks, "edges": edges, "surface": surface, "moved": moved}
        dispatch("shift/light", size, buffers, CELL=SHIFT_LIGHT_CELL)
        return moved

    def followed(self, chosen: GpuArray, moved: GpuArray, dual: bool, name: str) -> GpuArray:
        """Motion of `history_motion`, or without `dual` of `vectors`, with the shift: [H, W] motion, uncovered."""
        followed = self._scratch.image(f"shift.{name}", chosen.shape[:2])
        buffers = {"chosen": chosen, "moved": moved, "followed": followed}
        dispatch("shift/follow", chosen.shape[1::-1], buffers, DUAL=int(dual))
        return followed

    def find(
        self,
        inputs: Inputs,
        surfaces: tuple[GpuArray, GpuArray],
        vectors: GpuArray,
        denoised: GpuArray,
        history: History,
    ) -> tuple[GpuArray, tuple[GpuArray, ...]]:
        """The shifts of cells that a denoised picture shows; and those that the next frame takes, with those of frames
        before: `shift.picture.find`."""
        (H, W), pictures = inputs.surface.shape[:2], (denoised, history.denoised, history.surface)
        shift = self._displacement(pictures, inputs, vectors, surfaces[1], SHIFT_CELL, SHIFT_DAMPING)
        found, agreed = (self._scratch.fresh(shift.shape[:2]) for _ in range(2))
        buffers = {"shift": shift, "found_before": history.found or self.nothing((H, W)), "vectors": vectors}
        buffers |= {"found": found, "agreed": agreed}
        dispatch("shift/agree", shift.shape[1::-1], buffers, {"image_size": (W, H)}, CELL=SHIFT_CELL)
        return found, (agreed, *history.shifts)

    def nothing(self, size: tuple[int, ...]) -> GpuArray:
        """Shifts of the cells of a frame (H, W) in which there are none."""
        shifts = self._scratch.fresh(_cells(size, SHIFT_CELL))
        fill(shifts)
        return shifts

    def _near(self, which: str, blocks: GpuArray) -> GpuArray:
        """The blocks in and beside which there is one surface; where "even", only those with even light on it, and the
        scratch array `shift.edges` tells whether light has an edge in one."""
        near, edges = self._scratch(f"shift.{which}", blocks.shape[:2]), self._scratch("shift.edges", (1,), np.uint32)
        buffers = {"blocks": blocks, "near": near, "edges": edges}
        dispatch("shift/near", blocks.shape[1::-1], buffers, EVEN=int(which == "even"))
        return near

    def _displacement(
        self,
        pictures: tuple[GpuArray, GpuArray, GpuArray],  # a picture, the one before and its surface
        inputs: Inputs,
        vectors: GpuArray,
        near: GpuArray,  # which blocks count
        cell: int,
        damping: float,
        blur: bool = False,
    ) -> GpuArray:
        """The displacement of each cell of pixels [h, w]: `shift.displacement`."""
        scratch, (H, W), (now, before, surface_before) = self._scratch, inputs.surface.shape[:2], pictures
        blocks, scale = scratch("shift.brightness", _cells((H, W), BRIGHTNESS_BLOCK)), scratch("shift.scale", (1,))
        dispatch("shift/brightness", (W, H), {"picture": now, "blocks": blocks}, group=BLOCK_GROUP)
        parameters = {"count": blocks.shape[0] * blocks.shape[1], "pixels": float(H * W)}
        dispatch("shift/scale", (1,), {"blocks": blocks, "scale": scale}, parameters, SELECT_GROUP)
        pair, known = scratch.image("shift.pair", (H, W)), scratch.image("shift.known", (H, W))
        buffers = {"picture": now, "before": before, "scale": scale, "pair": pair}
        dispatch("shift/compress", (W, H), buffers, BLUR=int(blur))
        dispatch("shift/slopes", (W, H), {"pair": pair, "surface_before": surface_before, "known": known})
        h, w = _cells((H, W), cell)
        shift, sums = scratch.image(f"shift.{cell}", (h, w)), scratch(f"shift.sums.{cell}", (2, h, w, 4))
        buffers = {"pair": pair, "known": known, "vectors": vectors, "surface": inputs.surface, "near": near}
        buffers |= {"shift": shift, "sums": sums}
        side = cell // SHIFT_STRIDE
        for i in range(SHIFT_ROUNDS):
            constants = {"FIRST": int(i == 0), "CELL": cell}
            dispatch("shift/sums", (w * side, h * side), buffers, {"size": (W, H)}, (side, side), CUBIC=0, **constants)
            dispatch("shift/solve", (w, h), {"sums": sums, "shift": shift}, DAMPING=damping, **constants)
        return shift


def _cells(size: tuple[int, ...], side: int) -> tuple[int, int]:
    return tuple(-(-n // side) for n in size[:2])
