"""The passes of a frame, each a shader or a few, as far as its network: what they read, what they write, how they are
specialised."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .context import GpuArray
from .designs import ORDER, Design
from .dispatch import dispatch, fill
from .network import UNet, conv_layer
from .scratch import Scratch
from .state import History

BLOCK = 8  # side of the blocks that exposure is measured in
SELECT_GROUP = (256,)
NOTHING = 0xFFFFFFFF  # in the splat: no pixel


class Passes:
    """The passes of one model up to what its network predicts from; `kernels` has those after it."""

    def __init__(self, scratch: Scratch, design: Design, tensors: Mapping[str, np.ndarray]) -> None:
        self._scratch, self._design = scratch, design
        inputs = design.widths[0] if design.accumulates else design.features
        self._unet = UNet(scratch, tensors, inputs, design.widths)
        if design.accumulates:
            weight, bias = tensors["stem.weight"][:, ORDER], tensors["stem.bias"]
            self._stem = conv_layer(scratch.ctx, weight, bias, (design.features,))

    def prepare(self, layers: Mapping[str, GpuArray], into_history: bool = False) -> tuple[GpuArray, ...]:
        """Sanitised light, surface and guide, and the statistics of the frame. `into_history`: light and guide will go
        there, as surface does."""
        H, W = layers["radiance"].shape[1:]
        across, down = -(-W // BLOCK), -(-H // BLOCK)
        count, size = across * down, {"size": (W, H)}
        inputs = [layers[name] for name in ("radiance", "albedo", "normal", "depth")]
        clean, surface = self._scratch.image("clean", (H, W)), self._scratch.fresh((H, W))
        maxima = self._scratch("maxima", (down, across))
        if into_history:
            guide, light = self._scratch.fresh((H, W)), self._scratch.fresh((H, W))
        else:
            guide, light = self._scratch.image("guide", (H, W)), self._scratch.image("light", (H, W))
        dispatch(
            "frame/sanitise", [*inputs, clean, surface, guide, maxima], (W, H), size, (BLOCK, BLOCK),
            DEMODULATE=int(self._design.accumulates),
        )  # fmt: skip
        usual, blocks = self._scratch("usual", (1,)), self._scratch.image("blocks", (down, across))
        dispatch("frame/usual", [maxima, usual], (1,), {"count": count}, SELECT_GROUP)
        dispatch("frame/light", [clean, surface, guide, usual, light, blocks], (W, H), size, (BLOCK, BLOCK))
        statistics, kept = self._scratch("statistics", (2,)), max(1, int(0.9 * count))
        dispatch("frame/statistics", [blocks, statistics], (1,), {"count": count, "kept": kept}, SELECT_GROUP)
        return light, surface, guide, statistics

    def vectors(self, layers: Mapping[str, GpuArray]) -> GpuArray | None:
        """Sanitised motion and motion_next as one image; what is missing is not read later."""
        there = [layers[name] for name in ("motion", "motion_next") if name in layers]
        if not there:
            return None
        H, W = there[0].shape[1:]
        vectors = self._scratch.fresh((H, W))
        dispatch("frame/motion", [there[0], there[-1], vectors], (W, H), {"size": (W, H)})
        return vectors

    def mismatch(self, vectors: GpuArray, surface: GpuArray, surface_before: GpuArray) -> float:
        """Share of the pixels with history on the screen that find another surface there."""
        H, W = surface.shape[:2]
        counts = self._scratch("mismatch", (2,), np.uint32)
        fill(counts)
        dispatch("frame/mismatch", [vectors, surface, surface_before, counts], (W, H), {"size": (W, H)})
        seen, wrong = counts.read()
        return int(wrong) / max(1, int(seen))

    def history_motion(self, vectors: GpuArray, surface: GpuArray, history: History) -> GpuArray:
        """The motion that fetches history, dual where a pixel has been uncovered, and which those are."""
        H, W = surface.shape[:2]
        before = history.vectors
        if before is None:
            before = self._splat(vectors, surface, history.surface)
        chosen = self._scratch.image("chosen", (H, W))
        dispatch("frame/history_motion", [vectors, before, chosen], (W, H), {"size": (W, H)})
        return chosen

    def warp(
        self, chosen: GpuArray | None, light: GpuArray, guide: GpuArray, history: History | None, dual: bool
    ) -> GpuArray:
        """The reprojected previous output. `chosen` is what `history_motion` gives, or without `dual` the vectors."""
        H, W = light.shape[:2]
        past = self._scratch.image("past", (H, W))
        before = [light, light] if history is None else [chosen, history.denoised]
        buffers = [before[0], light, guide, before[1], past]
        constants = {"HISTORY": int(history is not None), "DUAL": int(dual), "CUBIC": int(self._design.accumulates)}
        dispatch("frame/warp", buffers, (W, H), {"size": (W, H)}, **constants)
        return past

    def reproject(
        self, chosen: GpuArray | None, surface: GpuArray, guide: GpuArray, history: History | None
    ) -> tuple[GpuArray, GpuArray]:
        """Running means: of light without this frame, of albedo with it."""
        H, W = surface.shape[:2]
        running, mean_albedo = self._scratch.image("running", (H, W)), self._scratch.fresh((H, W))
        before = [surface, surface, surface, surface]
        if history is not None:
            before = [chosen, history.surface, history.mean, history.mean_albedo]
        buffers = [before[0], surface, *before[1:], guide, running, mean_albedo]
        size, constants = {"size": (W, H)}, {"HISTORY": int(history is not None)}
        dispatch("accumulated_kpn/reproject", buffers, (W, H), size, **constants)
        return running, mean_albedo

    def _splat(self, vectors: GpuArray, surface: GpuArray, surface_before: GpuArray) -> GpuArray:
        """motion_next of the previous frame, approximate: `motion_splat.splat_motion_next`."""
        H, W = surface.shape[:2]
        inputs = [vectors, surface, surface_before]
        best, winner = (self._scratch(name, (H, W), np.uint32) for name in ("splat.best", "splat.winner"))
        before = self._scratch.image("splat.vectors", (H, W))
        for array in (best, winner):
            fill(array, NOTHING)
        for claim in (0, 1):
            dispatch("splat/bid", [*inputs, best, winner], (W, H), {"size": (W, H)}, CLAIM=claim)
        dispatch("splat/close", [*inputs, best, winner, before], (W, H), {"size": (W, H)})
        return before

    def features(
        self, light: GpuArray, surface: GpuArray, guide: GpuArray, past: GpuArray, statistics: GpuArray,
        means: tuple[GpuArray, ...], groups: int,
    ) -> GpuArray:  # fmt: skip
        """The network's input, padded: to whole cells of the U-Net, or to what the stem halves. `means` are what
        `reproject` returns, or nothing. With them only the first `groups` are written; the others are zero."""
        d, (H, W), cell = self._design, light.shape[:2], 2 if self._design.accumulates else self._unet.cell
        padded = (W + -W % cell, H + -H % cell)
        result = self._scratch.activations("features", d.features, padded[::-1])
        buffers = [light, surface, guide, past, statistics, *means, result]
        uniforms = {"size": padded, "image_size": (W, H)}
        uniforms |= {"longest": d.longest} if d.accumulates and groups > 4 else {}  # else it is not read
        constants = {"HALF": int(self._scratch.half)} | ({"GROUPS": groups} if d.accumulates else {})
        dispatch(f"{d.architecture}/features", buffers, padded, uniforms, **constants)
        return result

    def network(self, features: GpuArray, size: tuple[int, int], groups: int) -> list[GpuArray]:
        """Decoder features of the finest levels; `size` is (H, W) of the image, `groups` as for `features`."""
        return self._unet(self._stemmed(features, size, groups) if self._design.accumulates else features)

    def _stemmed(self, features: GpuArray, size: tuple[int, int], groups: int) -> GpuArray:
        """Features of half the size, padded to whole cells of the U-Net."""
        half = (size[1] + 1) // 2, (size[0] + 1) // 2
        W, H = (n + -n % self._unet.cell for n in half)
        result = self._scratch.activations("stem", self._stem.outputs, (H, W))
        dispatch(
            "network/stem", [features, self._stem.weights, self._stem.biases, result], (W, H, result.shape[0]),
            {"size": (W, H), "half_size": half, "groups": (groups, self._stem.groups[0])}, HALF=int(self._scratch.half),
        )  # fmt: skip
        return result
