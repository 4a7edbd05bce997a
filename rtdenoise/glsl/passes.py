"""The passes of a frame up to its network, each a shader or a few: which buffers they read and write, and how they are
specialised. `kernels` has the passes after it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..constants import (
    AGREES_PATIENCE,
    BRIGHTNESS_BLOCK,
    OUTDATED_CELL,
    OUTDATED_FRAMES,
    OUTDATED_RIM,
    RECALL_CELL,
    RELIT_CELL,
    RELIT_SIDES,
    SKY_BLOCK,
    TURNED_CELL,
)
from ..models.presets import AccumulatedKPNConfig, Config
from .context import GpuArray
from .dispatch import BLOCK_GROUP, SELECT_GROUP, dispatch, fill
from .network import HalfSizeUNet, UNet
from .recent import Recent
from .scratch import Scratch
from .state import History

NOTHING = 0xFFFFFFFF  # in the splat: no pixel
# Input channels of accumulated_kpn in the order of its features shader: those that may be zero everywhere come last.
FEATURE_ORDER = [0, 1, 2, 18, 6, 7, 8, 15, 9, 10, 11, 16, 12, 13, 14, 17, 3, 4, 5, 19, 20]


class Inputs(NamedTuple):
    """A sanitised frame."""

    light: GpuArray  # [H, W] rgb: radiance without fireflies, divided by its texture where the model does that
    surface: GpuArray  # [H, W] normal, depth
    guide: GpuArray  # [H, W] albedo, and whether light was divided by it
    statistics: GpuArray  # [2] exposure, mean distance
    more_history: bool = False  # of `Frame`


class Means(NamedTuple):
    """Running means, reprojected."""

    running: GpuArray  # [H, W] rgb, length: of light, without this frame
    mean_albedo: GpuArray  # [H, W] rgb, with this frame
    seen: GpuArray | None = None  # [3, H, W] footprints, without this frame (`Recent.recall`)


class Passes:
    """The passes of one model up to its network."""

    def __init__(self, scratch: Scratch, config: Config, tensors: Mapping[str, np.ndarray]) -> None:
        self._scratch, self._config = scratch, config
        self._accumulates = isinstance(config, AccumulatedKPNConfig)
        hybrid = config.architecture == "hybrid"
        self.recent = Recent(scratch, hybrid, hybrid and not config.many)
        if self._accumulates:
            self._network = HalfSizeUNet(scratch, tensors, FEATURE_ORDER, config.widths)
        else:
            self._network = UNet(scratch, tensors, config.features, config.widths)

    def prepare(
        self, layers: Mapping[str, GpuArray], into_history: bool = False, more_history: bool = False
    ) -> Inputs:
        """Sanitise the layers and measure the frame. `into_history`: history will keep light and guide, as it keeps
        surface, so they need buffers of their own. `more_history`: that of `Frame`."""
        H, W = layers["radiance"].shape[1:]
        blocks_size = _cells((H, W), BRIGHTNESS_BLOCK)
        count = blocks_size[0] * blocks_size[1]
        scratch, size = self._scratch, (W, H)
        clean, surface = scratch.image("clean", (H, W)), scratch.fresh((H, W))
        guide = scratch.fresh((H, W)) if into_history else scratch.image("guide", (H, W))
        light = scratch.fresh((H, W)) if into_history else scratch.image("light", (H, W))
        blocks, maxima = scratch.image("blocks", blocks_size), scratch("maxima", blocks_size)
        usual, statistics = scratch("usual", (1,)), scratch("statistics", (2,))

        packed = {"clean": clean, "surface": surface, "guide": guide}
        raw = {name: layers[name] for name in ("radiance", "albedo", "normal", "depth")}
        buffers = raw | packed | {"maxima": maxima}
        dispatch("frame/sanitise", size, buffers, group=BLOCK_GROUP, DEMODULATE=int(self._accumulates))
        dispatch("frame/usual", (1,), {"maxima": maxima, "usual": usual}, {"count": count}, SELECT_GROUP)
        buffers = packed | {"usual": usual, "light": light, "blocks": blocks}
        dispatch("frame/light", size, buffers, group=BLOCK_GROUP)
        buffers = {"blocks": blocks, "statistics": statistics}
        dispatch("frame/statistics", (1,), buffers, {"count": count}, SELECT_GROUP)
        return Inputs(light, surface, guide, statistics, more_history)

    def vectors(self, layers: Mapping[str, GpuArray]) -> GpuArray | None:
        """Sanitised motion and motion_next as one image; None if both are missing. If one is missing, the other fills
        its place, which nobody reads."""
        motion, motion_next = layers.get("motion"), layers.get("motion_next")
        there = motion or motion_next
        if there is None:
            return None
        H, W = there.shape[1:]
        vectors = self._scratch.fresh((H, W))
        buffers = {"motion": motion or there, "motion_next": motion_next or there, "vectors": vectors}
        dispatch("frame/motion", (W, H), buffers)
        return vectors

    def history_motion(self, vectors: GpuArray, surface: GpuArray, history: History) -> GpuArray:
        """The motion that fetches history: traditional, or dual, with a flag, where a pixel has been uncovered."""
        before = history.vectors or self._splat(vectors, surface, history.surface)
        chosen = self._scratch.image("chosen", surface.shape[:2])
        buffers = {"vectors": vectors, "vectors_before": before, "chosen": chosen}
        dispatch("frame/history_motion", surface.shape[1::-1], buffers)
        return chosen

    def radiance(self, inputs: Inputs) -> GpuArray:
        """The noisy radiance [H, W], no flags: in a first frame in place of the previous output; then for the next one,
        which follows its light."""
        radiance = self._scratch.fresh(inputs.light.shape[:2])
        buffers = {"light": inputs.light, "guide": inputs.guide, "past": radiance}
        dispatch("frame/first", radiance.shape[1::-1], buffers)
        return radiance

    def warp(self, chosen: GpuArray, inputs: Inputs, history: History, dual: bool) -> GpuArray:
        """The reprojected previous output. `chosen` comes from `history_motion`, or without `dual` from `vectors`."""
        past = self._scratch.image("past", inputs.light.shape[:2])
        buffers = {"chosen": chosen, "light": inputs.light, "guide": inputs.guide}
        buffers |= {"denoised_before": history.denoised, "past": past}
        buffers["mean_albedo_before"] = history.mean_albedo if self._accumulates else history.denoised
        kinds = {"DUAL": int(dual), "CUBIC": int(self._accumulates), "MEANS": int(self._accumulates)}
        dispatch("frame/warp", past.shape[1::-1], buffers, **kinds)
        return past

    def reproject(
        self, chosen: GpuArray, inputs: Inputs, history: History, level: GpuArray | None, dual: bool
    ) -> Means:
        """The running means, reprojected to this frame from the same surfaces only. `chosen`: as for `warp`; `level`:
        of `Recent.level`."""
        size, seen = inputs.surface.shape[:2], None
        running, mean_albedo = self._scratch.image("running", size), self._scratch.fresh(size)
        if self._config.recent:
            seen = self.recent.recall(chosen, inputs, history.recent, running, level, dual)
        buffers = {"chosen": chosen, "surface": inputs.surface, "guide": inputs.guide}
        buffers |= {"surface_before": history.surface, "mean_before": history.mean}
        buffers |= {"mean_albedo_before": history.mean_albedo, "running": running, "mean_albedo": mean_albedo}
        dispatch("accumulated_kpn/reproject", size[::-1], buffers, RECALLS=int(self._config.recent > 0))
        return Means(running, mean_albedo, seen)

    def turned(self, chosen: GpuArray, inputs: Inputs, history: History, still: bool) -> GpuArray:
        """How far history gives way in each cell, as its surfaces have turned, or textures have moved over them."""
        H, W = inputs.surface.shape[:2]
        cells = _cells((H, W), TURNED_CELL)
        sums = {name: self._scratch.image(name, cells) for name in ("turns", "counts", "aparts")}
        buffers = {"chosen": chosen, "surface": inputs.surface, "surface_before": history.surface}
        buffers |= {"guide": inputs.guide, "mean_albedo_before": history.mean_albedo}
        dispatch("accumulated_kpn/turns", (W, H), buffers | sums, STILL=int(still))
        turned = self._scratch("turned", cells)
        dispatch("accumulated_kpn/turned", cells[::-1], sums | {"turned": turned})
        return turned

    def outdated(
        self, inputs: Inputs, noisy: GpuArray, before: GpuArray, means: Means, turned: GpuArray, frames: int
    ) -> GpuArray:
        """The reprojected previous output without what is outdated. The mean of albedo gives way as `turned` says,
        which then gets the outdated share. `frames`: recent ones."""
        H, W = inputs.surface.shape[:2]
        past, most = self._scratch.image("shown", (H, W)), self._scratch("most", (*_cells((H, W), OUTDATED_RIM), 2))
        recalls, stays = self._config.recent > 0, means.running  # which is not read
        buffers = {"running": means.running, "mean_albedo": means.mean_albedo}
        if not recalls:
            cells = _cells((H, W), RECALL_CELL)
            sums, stays = {"cells": self._scratch.image("cells", cells)}, self._scratch("stays", cells)
            dispatch("accumulated_kpn/compare", (W, H), buffers | sums | {"light": inputs.light})
            sums |= {"pairs": stays, "stays": stays}  # pairs are not read
            dispatch("accumulated_kpn/stays", cells[::-1], sums, {"patience": AGREES_PATIENCE}, PAIRS=0)
        dispatch(
            "accumulated_kpn/agreement", most.shape[1::-1], buffers | {"stays": stays, "most": most},
            {"image_size": (W, H)}, RECALLS=int(recalls),
        )  # fmt: skip
        buffers |= {"guide": inputs.guide, "noisy": noisy, "before": before}
        buffers |= {"most": most, "past": past, "turned": turned}
        enough, group = float(max(1, min(frames, OUTDATED_FRAMES))), (OUTDATED_CELL, OUTDATED_CELL)
        dispatch("accumulated_kpn/outdated", (W, H), buffers, {"frames": enough}, group)
        return past

    def relight(self, inputs: Inputs, past: GpuArray, means: Means) -> None:
        """Multiply means and footprints by how much brighter light has become, then the previous output by how much
        brighter they are: `ops.relit`."""
        H, W = inputs.surface.shape[:2]
        extent, seen = _cells((H, W), RELIT_CELL), means.running if means.seen is None else means.seen
        cells = self._scratch("relit.cells", (2, *extent, 4))
        first, second = (self._scratch.image(f"relit.{side}", _cells(extent, side)) for side in RELIT_SIDES)
        images = {"running": means.running, "past": past, "seen": seen}
        for picture in (0, 1):
            kinds = {"PICTURE": picture, "SEEN": int(means.seen is not None)}
            buffers = images | {"light": inputs.light, "guide": inputs.guide, "cells": cells}
            dispatch("accumulated_kpn/gain", (W, H), buffers, **kinds)
            for side, known, gains in zip(RELIT_SIDES, (cells, first), (first, second), strict=True):
                buffers, size = {"cells": cells, "first": known, "gains": gains}, _cells(extent, side)[::-1]
                at = {"FIRST": int(known is cells), "SIDE": side}
                dispatch("accumulated_kpn/brighter", size, buffers, {"extent": extent[::-1]}, **at)
            dispatch("accumulated_kpn/relit", (W, H), images | {"first": first, "second": second}, **kinds)

    def features(self, inputs: Inputs, past: GpuArray, means: Means, groups: int) -> GpuArray:
        """The network's input, padded to whole cells of the network. Models that accumulate read `means` too, and write
        only the first `groups` of four features; the others are zero everywhere."""
        (H, W), cell = inputs.light.shape[:2], self._network.cell
        padded = (W + -W % cell, H + -H % cell)
        result = self._scratch.activations("features", self._config.features, padded[::-1])
        buffers = {"light": inputs.light, "surface": inputs.surface, "guide": inputs.guide}
        buffers |= {"statistics": inputs.statistics, "past": past, "result": result}
        parameters = {"image_size": (W, H)}
        constants = {"HALF": int(self._scratch.half)}
        if self._accumulates:
            buffers |= {"running": means.running, "mean_albedo": means.mean_albedo}
            parameters["longest"] = self._config.longest
            constants["GROUPS"] = groups
        kind = "accumulated_kpn" if self._accumulates else "temporal_kpn"
        dispatch(f"{kind}/features", padded, buffers, parameters, **constants)
        return result

    def network(self, features: GpuArray, groups: int) -> list[GpuArray]:
        """Decoder features of the finest levels; `groups` as for `features`."""
        return self._network(features, groups) if self._accumulates else self._network(features)

    def keep_even_sky(self, inputs: Inputs, result: GpuArray, denoised: GpuArray) -> None:
        """Write a sky without noise back into the denoised image [3, H, W] and into the same image for history."""
        H, W = inputs.surface.shape[:2]
        blocks = _cells((H, W), SKY_BLOCK)
        buffers = {"light": inputs.light, "surface": inputs.surface}
        buffers |= {name: self._scratch.image(name, blocks) for name in ("lowest", "highest")}
        dispatch("frame/sky_blocks", (W, H), buffers, group=(SKY_BLOCK, SKY_BLOCK))
        dispatch("frame/sky", (W, H), buffers | {"denoised": denoised, "result": result})

    def _splat(self, vectors: GpuArray, surface: GpuArray, surface_before: GpuArray) -> GpuArray:
        """motion_next of the previous frame, approximate: `rtdenoise.splat.splat_motion_next`."""
        size = surface.shape[:2]
        best, winner = (self._scratch(name, size, np.uint32) for name in ("splat.best", "splat.winner"))
        before = self._scratch.image("splat.vectors", size)
        fill(best, NOTHING)
        fill(winner, NOTHING)
        buffers = {"vectors": vectors, "surface": surface, "surface_before": surface_before}
        buffers |= {"best": best, "winner": winner}
        for claim in (0, 1):
            dispatch("splat/bid", size[::-1], buffers, CLAIM=claim)
        dispatch("splat/close", size[::-1], buffers | {"vectors_before": before})
        return before


def _cells(size: tuple[int, int], side: int) -> tuple[int, int]:
    """How many cells of so many pixels a side an image (H, W) has, cut-off ones too."""
    return -(-size[0] // side), -(-size[1] // side)
