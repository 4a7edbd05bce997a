"""The passes of a frame that apply what its network predicts: each multiplies the decoder's features by the rows of the
heads that it needs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .context import GpuArray
from .designs import Design, full_head
from .dispatch import dispatch
from .network import Layer, head_layer
from .scratch import Scratch


class Kernels:
    """The heads of one model, and the passes that compute and apply them."""

    def __init__(self, scratch: Scratch, design: Design, tensors: Mapping[str, np.ndarray]) -> None:
        self._scratch, self._design = scratch, design
        self._set_heads(tensors)

    def accumulate(self, features: GpuArray, light: GpuArray, running: GpuArray) -> GpuArray:
        """The running mean and its length, with this frame in it."""
        mean = self._scratch.fresh(light.shape[:2])
        buffers, uniforms = [light, running, mean], {"longest": self._design.longest}
        self._head("accumulated_kpn/accumulate", self._reset, features, buffers, uniforms)
        return mean

    def filter(self, levels: list[GpuArray], image: GpuArray) -> GpuArray:
        """Filter every scale with its own kernels, and from coarse to fine compose them and pick."""
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
                image = self._scratch.image(f"pyramid.{s}", sizes[s])
                H, W = sizes[s]
                dispatch("frame/downsample", [finer, image], (W, H), {"size": sizes[s - 1][::-1]}, POOL_MAX=self._pool)
            filtered.append(self._scratch.image(f"filtered.{s}", sizes[s]))
            self._head("frame/filter", self._spatial[s], features[s], [image, filtered[-1]], {}, KERNEL=d.kernel)
        coarse = filtered[-1]
        for s in reversed(range(d.scales - 1)):
            composed = self._scratch.image(f"composed.{s}", sizes[s])
            H, W = sizes[s]
            dispatch("frame/compose", [filtered[s], coarse, composed], (W, H), {"size": (W, H)}, POOL_MAX=self._pool)
            if self._picks:
                self._head("frame/pick", self._picks[s], features[s], [composed, coarse], {}, KERNEL=d.pick_kernel)
            coarse = composed
        return coarse

    def texture(self, features: GpuArray, composed: GpuArray, guide: GpuArray, mean_albedo: GpuArray) -> GpuArray:
        """The filtered light with its texture, and its edges smoothed."""
        now, edge = self._scratch.image("now", composed.shape[:2]), self._design.edge_kernel
        self._head("accumulated_kpn/texture", self._sharp, features, [composed, guide, mean_albedo, now], {})
        if edge == 1:
            return now
        smooth = self._scratch.image("smooth", composed.shape[:2])
        self._head("frame/filter", self._edge, features, [now, smooth], {}, KERNEL=edge)
        return smooth

    def blend(self, features: GpuArray, past: GpuArray, now: GpuArray) -> tuple[GpuArray, GpuArray]:
        """The denoised image [3, H, W], and what history keeps of it."""
        H, W = past.shape[:2]
        denoised, result = self._scratch.fresh((H, W)), self._scratch("result", (3, H, W))
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
        dispatch(name, buffers, (W, H), uniforms, CELL=cell, HALF=int(self._scratch.half), **constants)

    def _set_heads(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Split what the network predicts by the pass that needs it."""
        d, ctx, (weight, bias) = self._design, self._scratch.ctx, full_head(self._design, tensors)
        ends = np.cumsum(d.full_rows)[:-1]
        parts = zip(np.split(weight, ends, 1), np.split(bias, ends), strict=True)
        spatial, temporal, edge, pick, alpha, *shares = parts
        unused = np.zeros_like(weight[:, :1]), np.zeros_like(bias[:1])  # neither has an α

        def head(kernel: tuple[np.ndarray, np.ndarray], last: tuple[np.ndarray, np.ndarray]) -> Layer:
            return head_layer(ctx, np.concatenate([kernel[0], last[0]], 1), np.concatenate([kernel[1], last[1]]))

        self._spatial, self._temporal = [head(spatial, unused)], head(temporal, alpha)
        if d.accumulates:
            self._edge = head(edge, unused)
            self._reset, self._sharp = (head_layer(ctx, *share) for share in shares)
        self._picks = [head_layer(ctx, *pick)] if d.pick_rows else []
        first, rows = 0 if d.accumulates else 1, d.kernel**2 + 1
        for i in range(first, first + d.scales - 1):
            weight, bias = tensors[f"heads.{i}.weight"][None, :, :, 0, 0], tensors[f"heads.{i}.bias"]
            self._spatial.append(head_layer(ctx, weight[:, :rows], bias[:rows]))
            if len(bias) > rows:
                self._picks.append(head_layer(ctx, weight[:, rows:], bias[rows:]))

    @property
    def _pool(self) -> int:
        return int(self._design.pool == "max")
