"""The passes of a frame, each a shader or a few: what they read, what they write, how they are specialised."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl
import numpy as np

from .context import GpuArray
from .designs import ORDER, Design, full_head
from .dispatch import dispatch, fill
from .network import Layer, UNet, conv_layer, head_layer
from .scratch import Scratch
from .state import History

BLOCK = 8  # side of the blocks that exposure is measured in
SELECT_GROUP = (256,)
NOTHING = 0xFFFFFFFF  # in the splat: no pixel


class Passes:
    """The passes of one model on one context, with the buffers that they keep between frames."""

    def __init__(self, ctx: moderngl.Context, design: Design, tensors: Mapping[str, np.ndarray], half: bool) -> None:
        self._ctx, self._design, self._half, self._scratch = ctx, design, half, Scratch(ctx)
        inputs = design.widths[0] if design.accumulates else design.features
        self._unet = UNet(ctx, self._scratch, tensors, inputs, design.widths, np.float16 if half else np.float32)
        if design.accumulates:
            self._stem = conv_layer(ctx, tensors["stem.weight"][:, ORDER], tensors["stem.bias"], (design.features,))
        self._set_heads(tensors)

    @property
    def scratch_bytes(self) -> int:
        """GPU memory that is kept between frames, beside the weights."""
        return self._scratch.nbytes

    def prepare(self, layers: Mapping[str, GpuArray], kept: bool = False) -> tuple[GpuArray, ...]:
        """Sanitised light, surface and guide, and the statistics of the frame. `kept`: light and guide will go into
        history, as surface does."""
        H, W = layers["radiance"].shape[1:]
        across, down = -(-W // BLOCK), -(-H // BLOCK)
        count, size = across * down, {"size": (W, H)}
        inputs = [layers[name] for name in ("radiance", "albedo", "normal", "depth")]
        clean, surface = self._image("clean", (H, W)), self._fresh((H, W))
        maxima = self._scratch("maxima", (down, across))
        guide, light = (self._fresh((H, W)) if kept else self._image(name, (H, W)) for name in ("guide", "light"))
        dispatch(
            "frame/sanitise", [*inputs, clean, surface, guide, maxima], (W, H), size, (BLOCK, BLOCK),
            DEMODULATE=int(self._design.accumulates),
        )  # fmt: skip
        usual, blocks = self._scratch("usual", (1,)), self._image("blocks", (down, across))
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
        vectors = self._fresh((H, W))
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
        chosen = self._image("chosen", (H, W))
        dispatch("frame/history_motion", [vectors, before, chosen], (W, H), {"size": (W, H)})
        return chosen

    def warp(
        self, chosen: GpuArray | None, light: GpuArray, guide: GpuArray, history: History | None, dual: bool
    ) -> GpuArray:
        """The reprojected previous output. `chosen` is what `history_motion` gives, or without `dual` the vectors."""
        H, W = light.shape[:2]
        past = self._image("past", (H, W))
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
        running, mean_albedo = self._image("running", (H, W)), self._fresh((H, W))
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
        before = self._image("splat.vectors", (H, W))
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
        result = self._activations("features", d.features, padded[::-1])
        buffers = [light, surface, guide, past, statistics, *means, result]
        uniforms = {"size": padded, "image_size": (W, H)}
        uniforms |= {"longest": d.longest} if d.accumulates and groups > 4 else {}  # else it is not read
        constants = {"HALF": int(self._half)} | ({"GROUPS": groups} if d.accumulates else {})
        dispatch(f"{d.architecture}/features", buffers, padded, uniforms, **constants)
        return result

    def network(self, features: GpuArray, size: tuple[int, int], groups: int) -> list[GpuArray]:
        """Decoder features of the finest levels; `size` is (H, W) of the image, `groups` as for `features`."""
        return self._unet(self._stemmed(features, size, groups) if self._design.accumulates else features)

    def _stemmed(self, features: GpuArray, size: tuple[int, int], groups: int) -> GpuArray:
        """Features of half the size, padded to whole cells of the U-Net."""
        half = (size[1] + 1) // 2, (size[0] + 1) // 2
        W, H = (n + -n % self._unet.cell for n in half)
        result = self._activations("stem", self._stem.outputs, (H, W))
        dispatch(
            "network/stem", [features, self._stem.weights, self._stem.biases, result], (W, H, result.shape[0]),
            {"size": (W, H), "half_size": half, "groups": (groups, self._stem.groups[0])}, HALF=int(self._half),
        )  # fmt: skip
        return result

    def accumulate(self, features: GpuArray, light: GpuArray, running: GpuArray) -> GpuArray:
        """The running mean and its length, with this frame in it."""
        mean = self._fresh(light.shape[:2])
        self._head(
            "accumulated_kpn/accumulate",
            self._reset,
            features,
            [light, running, mean],
            {"longest": self._design.longest},
        )
        return mean

    def filter(self, levels: list[GpuArray], image: GpuArray) -> GpuArray:
        """Filter every scale with its own kernels and compose from coarse to fine."""
        d, size = self._design, image.shape[:2]
        sizes = [size]
        for _ in range(d.scales - 1):
            sizes.append(tuple((n + 1) // 2 for n in sizes[-1]))
        features = [levels[0], *levels] if d.accumulates else levels
        filtered: list[GpuArray] = []
        for s in range(d.scales):
            if s:
                # accumulated_kpn filters what the finer scale has filtered, temporal_kpn a pyramid of the noise
                finer = filtered[-1] if d.accumulates else image
                image = self._image(f"pyramid.{s}", sizes[s])
                H, W = sizes[s]
                dispatch("frame/downsample", [finer, image], (W, H), {"size": sizes[s - 1][::-1]}, POOL_MAX=self._pool)
            filtered.append(self._image(f"filtered.{s}", sizes[s]))
            self._head("frame/filter", self._spatial[s], features[s], [image, filtered[-1]], {}, KERNEL=d.kernel)
        coarse = filtered[-1]
        for s in reversed(range(d.scales - 1)):
            composed = self._image(f"composed.{s}", sizes[s])
            H, W = sizes[s]
            dispatch("frame/compose", [filtered[s], coarse, composed], (W, H), {"size": (W, H)}, POOL_MAX=self._pool)
            coarse = composed
        return coarse

    def texture(self, features: GpuArray, composed: GpuArray, guide: GpuArray, mean_albedo: GpuArray) -> GpuArray:
        """The filtered light with its texture, and its edges smoothed."""
        now, edge = self._image("now", composed.shape[:2]), self._design.edge_kernel
        self._head("accumulated_kpn/texture", self._sharp, features, [composed, guide, mean_albedo, now], {})
        if edge == 1:
            return now
        smooth = self._image("smooth", composed.shape[:2])
        self._head("frame/filter", self._edge, features, [now, smooth], {}, KERNEL=edge)
        return smooth

    def blend(self, features: GpuArray, past: GpuArray, now: GpuArray) -> tuple[GpuArray, GpuArray]:
        """The denoised image [3, H, W], and what history keeps of it."""
        H, W = past.shape[:2]
        denoised, result = self._fresh((H, W)), self._scratch("result", (3, H, W))
        constants = {"KERNEL": self._design.temporal_kernel, "REPLACE": int(self._design.accumulates)}
        self._head("frame/temporal", self._temporal, features, [past, now, denoised, result], {}, **constants)
        return result, denoised

    def _head(
        self, name: str, head: Layer, features: GpuArray, buffers: list[GpuArray], uniforms: dict, **constants: int
    ) -> None:
        """A pass that computes rows of a head from `features` where it needs them. `buffers[0]` has its size."""
        H, W = buffers[0].shape[:2]
        cell = 2 if head.weights.shape[0] == 4 else 1
        uniforms |= {"size": (W, H), "feature_size": features.shape[2:0:-1], "groups": head.groups[0]}
        buffers = [features, head.weights, head.biases, *buffers]
        dispatch(name, buffers, (W, H), uniforms, CELL=cell, HALF=int(self._half), **constants)

    def _set_heads(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Split what the network predicts by the pass that needs it."""
        d, (weight, bias) = self._design, full_head(self._design, tensors)
        ends = np.cumsum(d.full_rows)[:-1]
        spatial, temporal, edge, alpha, *shares = zip(np.split(weight, ends, 1), np.split(bias, ends), strict=True)
        unused = np.zeros_like(weight[:, :1]), np.zeros_like(bias[:1])  # neither has an α

        def head(kernel: tuple[np.ndarray, np.ndarray], last: tuple[np.ndarray, np.ndarray]) -> Layer:
            return head_layer(self._ctx, np.concatenate([kernel[0], last[0]], 1), np.concatenate([kernel[1], last[1]]))

        self._spatial, self._temporal = [head(spatial, unused)], head(temporal, alpha)
        if d.accumulates:
            self._edge = head(edge, unused)
            self._reset, self._sharp = (head_layer(self._ctx, *share) for share in shares)
        first = 0 if d.accumulates else 1
        for i in range(first, first + d.scales - 1):
            self._spatial.append(
                head_layer(self._ctx, tensors[f"heads.{i}.weight"][None, :, :, 0, 0], tensors[f"heads.{i}.bias"])
            )

    @property
    def _pool(self) -> int:
        return int(self._design.pool == "max")

    def _image(self, name: str, size: tuple[int, int]) -> GpuArray:
        return self._scratch(name, (*size, 4))

    def _activations(self, name: str, channels: int, size: tuple[int, int]) -> GpuArray:
        return self._scratch(name, (-(-channels // 4), *size, 4), np.float16 if self._half else np.float32)

    def _fresh(self, size: tuple[int, int]) -> GpuArray:
        """An image that goes into history: nobody may write it again."""
        return GpuArray.empty(self._ctx, (*size, 4))
