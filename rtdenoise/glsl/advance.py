"""Whether a frame goes on with its shot, and how far the camera has gone ahead since the one before, in the shaders:
`rtdenoise.history`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..constants import ADVANCE_GAIN, ADVANCE_LEAST, ADVANCE_MOST, CUT_AROUND, CUT_UNMOVED, DEPTH_TOLERANCE, MOVES
from ..data.stored import seen_step
from ..frame import MAX_CUT_MISMATCH
from .context import GpuArray
from .dispatch import dispatch, fill
from .scratch import Scratch
from .state import History


class Advance:
    """Its passes, and what is counted between them."""

    def __init__(self, scratch: Scratch) -> None:
        self._scratch = scratch

    def mismatch(self, vectors: GpuArray, surface: GpuArray, before: GpuArray) -> float:
        """`history.mismatch`, of surfaces [H, W] (normal, depth). Waits for the GPU."""
        counts, (H, W) = self._scratch("mismatch", (4,), np.uint32), surface.shape[:2]
        buffers = {"vectors": vectors, "surface": surface, "surface_before": before, "counts": counts}

        def counted(around: int) -> tuple[int, ...]:
            fill(counts)
            dispatch("frame/mismatch", (W, H), buffers, AROUND=around)
            return tuple(map(int, counts.read()))

        seen, wrong, beside, moves = counted(0)
        usual = beside / max(1, H * (W - 1))
        found = max(0.0, wrong / max(1, seen) - usual) / max(1 - usual, 1e-6)
        unmoved = not moves and found > MOVES
        if not unmoved and found <= MAX_CUT_MISMATCH:
            return found
        lost = counted(1)[1]
        if unmoved:
            return min(CUT_UNMOVED * lost / max(1, seen), 1.0)
        if by := self.find(vectors, surface, before):
            buffers["surface_before"] = self.surface(before, by)
            lost = min(lost, counted(0)[1])
        return min(found, CUT_AROUND * lost / max(1, seen))

    def find(self, vectors: GpuArray, surface: GpuArray, before: GpuArray) -> float:
        """`history.advance`, of surfaces [H, W] (normal, depth). Waits for the GPU."""
        H, W = surface.shape[:2]
        step = seen_step((H, W))
        places = self._scratch.image("places", (-(-H // step), -(-W // step)))
        buffers = {"vectors": vectors, "surface": surface, "surface_before": before, "places": places}
        dispatch("frame/advance", places.shape[1::-1], buffers, {"image_size": (W, H), "step": step})
        near, far, facing, seen = np.moveaxis(places.read(), 2, 0)
        both = (seen > 0) & (near > 0) & (far > 0)
        if not both.any():
            return 0.0
        by, way = (_median(x[both]) for x in (far - near, near))
        if not ADVANCE_LEAST * way < abs(by) < ADVANCE_MOST * way:
            return 0.0
        found, more = (_found(near, x, facing, seen) for x in (far, _nearer(far, by)))
        return float(by) if more - found > ADVANCE_GAIN * np.count_nonzero(seen) else 0.0

    def history(self, history: History, by: float) -> History:
        """A history as from a camera that has gone ahead by so much."""
        recent = tuple(self.kept(kept, by) for kept in history.recent)
        return replace(history, surface=self.surface(history.surface, by), recent=recent)

    def surface(self, surface: GpuArray, by: float) -> GpuArray:
        size = surface.shape[:2]
        shifted = self._scratch.fresh(size)
        dispatch("frame/nearer", size[::-1], {"surface": surface, "shifted": shifted}, {"by": by})
        return shifted

    def kept(self, kept: GpuArray, by: float) -> GpuArray:
        words, *size = kept.shape
        shifted = GpuArray.empty(kept.buffer.ctx, kept.shape, np.uint32)
        dispatch("accumulated_kpn/nearer", (*size[::-1], words), {"kept": kept, "shifted": shifted}, {"by": by})
        return shifted


def _median(values: np.ndarray) -> np.float32:
    """The lower one."""
    middle = (values.size - 1) // 2
    return np.partition(values, middle)[middle]


def _nearer(depth: np.ndarray, by: np.float32) -> np.ndarray:
    return np.where(depth > 0, np.maximum(depth - by, np.finfo(np.float32).tiny), depth)


def _found(near: np.ndarray, far: np.ndarray, facing: np.ndarray, seen: np.ndarray) -> int:
    """How many of the places `seen` show the same surface, as `ops.alike` says."""
    alike = (np.abs(near - far) <= DEPTH_TOLERANCE * np.maximum(near, far)) & (facing > 0)
    hit, was_hit = near > 0, far > 0
    return np.count_nonzero(np.where(hit & was_hit, alike, hit == was_hit) & (seen > 0))
