"""Light that moves otherwise than its surfaces, in mirrors and behind glass: `rtdenoise.shift` as passes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..constants import (
    SHIFT_BLOCK,
    SHIFT_CELL,
    SHIFT_DAMPING,
    SHIFT_LIGHT_CELL,
    SHIFT_LIGHT_DAMPING,
    SHIFT_ROUNDS,
    SHIFT_STRIDE,
)
from .context import GpuArray
from .dispatch import SELECT_GROUP, dispatch, fill
from .scratch import Scratch
from .state import History

if TYPE_CHECKING:
    from .passes import Inputs

BLOCK = 8  # side of the blocks that brightness is summed over


class Follow:
    """The passes that find how light has moved, and add it to motion."""

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch

    def noisy(self, inputs: Inputs) -> GpuArray:
        """The radiance of a frame [H, W], for the next one."""
        noisy = self._scratch.fresh(inputs.light.shape[:2])
        buffers = {"light": inputs.light, "guide": inputs.guide, "past": noisy}
        dispatch("frame/first", noisy.shape[1::-1], buffers)
        return noisy

    def shift(
        self,
        inputs: Inputs,
        vectors: GpuArray,
        noisy: GpuArray,  # of this frame
        noisy_before: GpuArray,
        surface_before: GpuArray,
        told: tuple[GpuArray, ...],  # the shifts that the frame before agreed on, if there are any
    ) -> GpuArray:
        """How far light has moved over its surfaces, [H, W] pixels: `models.past.shift_of`."""
        scratch, surface = self._scratch, inputs.surface
        size = surface.shape[1::-1]
        moved, edges = scratch.image("shift.moved", surface.shape[:2]), scratch("shift.edges", (1,), np.uint32)
        fill(edges)
        blocks = self._blocks(inputs, noisy)
        near, flat = self._near(blocks, edges, even=True), self._near(blocks, edges)
        (told,) = told or (self._nothing(surface.shape),)
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
        self, inputs: Inputs, vectors: GpuArray | None, denoised: GpuArray, history: History | None
    ) -> tuple[GpuArray, tuple[GpuArray, ...]]:
        """The shifts of cells that a denoised picture shows; and those that the next frame takes, with those of frames
        before: `shift.picture.find`. None in a first frame."""
        (H, W), edges = inputs.surface.shape[:2], self._scratch("shift.edges", (1,), np.uint32)
        if history is None:
            return self._nothing((H, W)), (self._nothing((H, W)),)
        near = self._near(self._blocks(inputs, denoised), edges)
        pictures = denoised, history.denoised, history.surface
        shift = self._displacement(pictures, inputs, vectors, near, SHIFT_CELL, SHIFT_DAMPING)
        found, agreed = (self._scratch.fresh(shift.shape[:2]) for _ in range(2))
        buffers = {"shift": shift, "found_before": history.found or self._nothing((H, W)), "vectors": vectors}
        buffers |= {"found": found, "agreed": agreed}
        dispatch("shift/agree", shift.shape[1::-1], buffers, {"image_size": (W, H)}, CELL=SHIFT_CELL)
        return found, (agreed, *history.shifts)

    def _nothing(self, size: tuple[int, ...]) -> GpuArray:
        """Shifts of the cells of a frame (H, W) in which there are none."""
        shifts = self._scratch.fresh(_cells(size, SHIFT_CELL))
        fill(shifts)
        return shifts

    def _blocks(self, inputs: Inputs, picture: GpuArray) -> GpuArray:
        """Light of a picture, and depth, of each block."""
        (H, W), extent = inputs.surface.shape[:2], _cells(inputs.surface.shape, SHIFT_BLOCK)
        blocks = self._scratch.image("shift.blocks", extent)
        buffers = {"picture": picture, "surface": inputs.surface, "blocks": blocks}
        dispatch("shift/blocks", extent[::-1], buffers, {"image_size": (W, H)})
        return blocks

    def _near(self, blocks: GpuArray, edges: GpuArray, even: bool = False) -> GpuArray:
        """The blocks in and beside which there is one surface, or `even` light on it; then `edges` tells of edges."""
        near = self._scratch("shift.even" if even else "shift.flat", blocks.shape[:2])
        buffers = {"blocks": blocks, "near": near, "edges": edges}
        dispatch("shift/near", blocks.shape[1::-1], buffers, EVEN=int(even))
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
        blocks, scale = scratch("shift.brightness", _cells((H, W), BLOCK)), scratch("shift.scale", (1,))
        dispatch("shift/brightness", (W, H), {"picture": now, "blocks": blocks}, group=(BLOCK, BLOCK))
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
            constants = {"FIRST": int(i == 0), "CELL": cell, "STRIDE": SHIFT_STRIDE}
            dispatch("shift/sums", (w * side, h * side), buffers, {"size": (W, H)}, (side, side), CUBIC=0, **constants)
            dispatch("shift/solve", (w, h), {"sums": sums, "shift": shift}, DAMPING=damping, **constants)
        return shift


def _cells(size: tuple[int, ...], side: int) -> tuple[int, int]:
    return tuple(-(-n // side) for n in size[:2])
