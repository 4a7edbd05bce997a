"""Recent frames, kept and looked up anew by each frame: `rtdenoise.ops.recall` and `ops.over` as passes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..constants import NOISE_WINDOW, NOISE_WINDOWS, RECALL_CELL, RECALL_FOOTPRINT_WORDS, RECALL_WORDS, RESET_MORE
from .context import GpuArray
from .dispatch import SELECT_GROUP, dispatch, fill
from .scratch import Scratch

if TYPE_CHECKING:
    from .passes import Inputs

NO_WINDOW = 0xBF800000  # the word of -1: a window of `hybrid/noise` that tells nothing


class Recent:
    """The passes of kept frames. With `footprints` these hold what was seen in each pixel, too (`hybrid`), with `few`
    samples wherever it was hit (`rtdenoise.ops.scattered`), and however little noise there is."""

    def __init__(self, scratch: Scratch, footprints: bool, few: bool = False) -> None:
        self._scratch, self._footprints, self._few = scratch, footprints, few

    @property
    def words(self) -> int:
        """Words of a kept frame."""
        return RECALL_FOOTPRINT_WORDS if self._footprints else RECALL_WORDS

    def keep(self, inputs: Inputs, vectors: GpuArray | None, moves: bool) -> GpuArray:
        """This frame as later ones recall it, [words, H, W]. `moves`: the frame has motion."""
        size, ctx = inputs.surface.shape[:2], inputs.surface.buffer.ctx
        kept = GpuArray.empty(ctx, (self.words, *size), np.uint32)
        buffers = {"surface": inputs.surface, "vectors": vectors or inputs.light, "kept": kept}
        dispatch("accumulated_kpn/keep", size[::-1], buffers | {"light": inputs.light}, MOVES=int(moves))
        if self._footprints:
            dispatch("hybrid/keep", size[::-1], buffers | {"guide": inputs.guide}, MOVES=int(moves))
        return kept

    def forget(
        self,
        reset: GpuArray,  # [H, W] of the network
        turned: GpuArray | None,
        kept: GpuArray,
        inputs: Inputs,
        vectors: GpuArray,
        surface_before: GpuArray,
        chosen: GpuArray | None,  # of `history_motion`, where that is dual
    ) -> None:
        """Write into a kept frame how far light was reset to it: by the network, where it `turned`, and where something
        else passed (`ops.passed`)."""
        buffers = {"reset": reset, "turned": turned or reset, "kept": kept, "vectors": vectors}
        buffers |= {"chosen": chosen or vectors, "surface": inputs.surface, "surface_before": surface_before}
        kinds = {"TURNS": int(turned is not None), "DUAL": int(chosen is not None)}
        dispatch("accumulated_kpn/forget", kept.shape[:0:-1], buffers, **kinds)

    def recall(
        self,
        chosen: GpuArray,  # of `history_motion`, or without `dual` of `vectors`
        inputs: Inputs,
        recent: tuple[GpuArray, ...],
        running: GpuArray,
        level: GpuArray | None,  # of `level`
        dual: bool,
    ) -> GpuArray | None:
        """Write the mean light of recent frames, and the sum of their weights. Returns the footprints [3, H, W] of
        `hybrid/look`."""
        size, last = inputs.surface.shape[:2], len(recent) - 1
        extent = tuple(-(-n // RECALL_CELL) for n in size)
        found = self._scratch.image("recall.found", size)
        cells, seen = self._scratch.image("cells", extent), None
        pairs, stays = (self._scratch(name, extent) for name in ("pairs", "stays"))
        now = {"light": inputs.light, "surface": inputs.surface, "chosen": chosen}
        now["path"] = self._scratch.image("path", size)
        if self._footprints:
            seen = self._scratch("seen", (3, *size, 4))
            through = {"surface": inputs.surface, "chosen": chosen, "stays": stays, "seen": seen}
            through |= {"edge": self._scratch.image("edge", size), "level": level}
            through["lone"] = self._scattered(inputs) if self._few and recent else inputs.surface
        if not recent:
            fill(running)
            if seen is not None:
                fill(seen)
        for i, kept in enumerate(recent):
            buffers, at = now | {"kept": kept, "found": found, "cells": cells, "pairs": pairs}, {"FIRST": int(i == 0)}
            dispatch("accumulated_kpn/look", size[::-1], buffers, **at)
            sums = {"cells": cells, "pairs": pairs, "stays": stays}
            dispatch("accumulated_kpn/stays", extent[::-1], sums, {"patience": 1.0}, PAIRS=1)
            buffers, at = {"found": found, "stays": stays, "running": running}, at | {"LAST": int(i == last)}
            dispatch("accumulated_kpn/add", size[::-1], buffers, **at)
            if seen is not None:
                at |= {"DUAL": int(dual), "LONE": int(self._few)}
                dispatch("hybrid/look", size[::-1], through | {"kept": kept}, **at)
        return seen

    def see(
        self, inputs: Inputs, past: GpuArray, seen: GpuArray | None, reset: GpuArray | None, turned: GpuArray | None
    ) -> GpuArray:
        """Footprints [3, H, W] with this frame in them, the trust in history, and how far that stays. `seen`, `reset`
        and `turned`, of `Passes.outdated`: None in a first frame."""
        size = past.shape[:2]
        shown = self._scratch("seen", (3, *size, 4)) if seen is None else seen
        buffers = {"light": inputs.light, "guide": inputs.guide, "surface": inputs.surface, "past": past, "seen": shown}
        buffers |= {"reset": reset or past, "turned": turned or past}
        counts = RESET_MORE if inputs.more_history and not self._few else 1.0
        kinds = {"ALONE": int(seen is None), "TURNS": int(turned is not None)}
        dispatch("hybrid/see", size[::-1], buffers, RESET=counts, **kinds)
        return shown

    def over(self, seen: GpuArray, inputs: Inputs, vectors: GpuArray, recent: tuple[GpuArray, ...]) -> GpuArray:
        """The footprints `seen`, this frame in them, with edges that move against what is behind them."""
        size = inputs.surface.shape[:2]
        buffers = {"seen": seen, "light": inputs.light, "guide": inputs.guide, "surface": inputs.surface}
        buffers |= {"vectors": vectors, "front": self._scratch("front", (*size, 4))}
        buffers["over"] = over = self._scratch("over", (3, *size, 4))
        for i, kept in enumerate(recent):
            at = {"FIRST": int(i == 0), "LAST": int(i == len(recent) - 1)}
            dispatch("hybrid/over", size[::-1], buffers | {"kept": kept}, **at)
        return over

    def _scattered(self, inputs: Inputs) -> GpuArray:
        """The depths of what is scattered around each pixel, [H, W]: `rtdenoise.ops.scattered`."""
        size = inputs.surface.shape[:2]
        alone, lone = self._scratch("alone", size), self._scratch.image("lone", size)
        dispatch("hybrid/alone", size[::-1], {"surface": inputs.surface, "alone": alone})
        dispatch("hybrid/scattered", size[::-1], {"alone": alone, "lone": lone})
        return lone

    def level(self, inputs: Inputs) -> GpuArray | None:
        """What the noise of this frame decides of footprints, [3]: how much less lookups off the pixel count
        (`models.past.misplaced`), how far light is evened, and how much the frame's word counts (`models.hybrid`). None
        without footprints."""
        if not self._footprints:
            return None
        H, W = inputs.surface.shape[:2]
        windows = tuple(max(n - NOISE_WINDOW, 0) // NOISE_WINDOWS + 1 for n in (H, W))
        relative, level = self._scratch("relative", windows), self._scratch("level", (3,))
        if min(H, W) < NOISE_WINDOW:
            fill(relative, NO_WINDOW)
        else:
            buffers = {"light": inputs.light, "guide": inputs.guide, "surface": inputs.surface, "relative": relative}
            dispatch("hybrid/noise", windows[::-1], buffers, {"image_size": (W, H)})
        buffers, parameters = {"relative": relative, "level": level}, {"count": windows[0] * windows[1]}
        kinds = {"FEW": int(self._few), "MORE": int(inputs.more_history)}
        dispatch("hybrid/level", (1,), buffers, parameters, SELECT_GROUP, **kinds)
        return level
