"""The passes of a frame that apply the network's predictions. Each pass computes its heads from the decoder's features,
at the pixel where it uses them: logits never reach memory."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..constants import RECALL_SAME
from ..models.presets import AccumulatedKPNConfig, Config
from .context import GpuArray
from .dispatch import dispatch
from .heads import HeadLayer
from .scratch import Scratch


class Kernels:
    """The passes of one model after its network. `levels` are its decoder features, finest first."""

    def __init__(self, scratch: Scratch, config: Config, tensors: Mapping[str, np.ndarray]) -> None:
        self._scratch, self._config = scratch, config
        self._accumulates = isinstance(config, AccumulatedKPNConfig)
        self._heads = HeadLayer(scratch.ctx, config, tensors)
        self._pool = {"POOL_MAX": int(getattr(config, "pool", "mean") == "max")}

    def accumulate(
        self, levels: list[GpuArray], light: GpuArray, running: GpuArray, turned: GpuArray | None
    ) -> tuple[GpuArray, GpuArray]:
        """The running mean of light and its length, with this frame in it, and the reset that the network said.
        `turned`: that of `Passes`."""
        size = light.shape[:2]
        mean, reset = self._scratch.fresh(size), self._scratch("reset", size)
        buffers, parameters = {"light": light, "running": running}, {"longest": self._config.longest}
        parameters["same"] = RECALL_SAME if self._config.recent else 0.0
        buffers |= {"mean": mean, "reset": reset}
        self._over_time("accumulated_kpn/accumulate", levels, ("shares",), buffers, turned, parameters)
        return mean, reset

    def filter(self, levels: list[GpuArray], image: GpuArray) -> GpuArray:
        """Filter every scale with its own kernels; then, from coarse to fine, compose, soften and pick."""
        filtered = [self._filter(levels, 0, ("spatial",), image, "filtered.0")]
        for s in range(1, self._config.scales):
            # accumulated_kpn filters the filtered finer scale, temporal_kpn a pyramid of the noise
            image = self._downsample(filtered[-1] if self._accumulates else image, f"pyramid.{s}")
            filtered.append(self._filter(levels, s, ("spatial", "alpha"), image, f"filtered.{s}"))
        coarse = filtered.pop()
        for s in reversed(range(len(filtered))):
            composed = self._compose(filtered[s], coarse, f"composed.{s}")
            if self._heads.has(s, "detail"):
                buffers = {"composed": composed, "fine": filtered[s]}
                self._predict("frame/soften", levels, s, ("detail",), buffers, **self._pool)
            if self._heads.has(s, "pick"):
                self._pick(levels, s, composed, coarse)
            coarse = composed
        return coarse

    def texture(self, levels: list[GpuArray], composed: GpuArray, guide: GpuArray, mean_albedo: GpuArray) -> GpuArray:
        """The filtered light times its texture, with edges smoothed if the model has an edge kernel."""
        now = self._scratch.image("now", composed.shape[:2])
        buffers = {"composed": composed, "guide": guide, "mean_albedo": mean_albedo, "now": now}
        self._predict("accumulated_kpn/texture", levels, 0, ("shares",), buffers)
        return self._filter(levels, 0, ("edge",), now, "smooth") if self._heads.has(0, "edge") else now

    def blend(
        self, levels: list[GpuArray], past: GpuArray, now: GpuArray, turned: GpuArray | None
    ) -> tuple[GpuArray, GpuArray]:
        """The denoised image [3, H, W], and the same as an image for history. `turned`: that of `Passes`."""
        H, W = past.shape[:2]
        denoised, result = self._scratch.fresh((H, W)), self._scratch("result", (3, H, W))
        buffers = {"past": past, "now": now, "denoised": denoised, "result": result}
        heads = "temporal", "shares" if self._accumulates else "alpha_temporal"
        constants = {"KERNEL": self._heads.kernel(0, "temporal"), "REPLACE": int(self._accumulates)}
        self._over_time("frame/temporal", levels, heads, buffers, turned, **constants)
        return result, denoised

    def _filter(
        self, levels: list[GpuArray], scale: int, heads: tuple[str, ...], image: GpuArray, name: str
    ) -> GpuArray:
        """The image filtered with the kernels of the first head, and the weights of the second in its alpha channel."""
        filtered = self._scratch.image(name, image.shape[:2])
        buffers, kernel = {"image": image, "filtered": filtered}, self._heads.kernel(scale, heads[0])
        self._predict("frame/filter", levels, scale, heads, buffers, KERNEL=kernel)
        return filtered

    def _downsample(self, fine: GpuArray, name: str) -> GpuArray:
        H, W = fine.shape[:2]
        coarse = self._scratch.image(name, ((H + 1) // 2, (W + 1) // 2))
        buffers = {"fine": fine, "coarse": coarse}
        dispatch("frame/downsample", coarse.shape[1::-1], buffers, {"size": (W, H)}, **self._pool)
        return coarse

    def _compose(self, fine: GpuArray, coarse: GpuArray, name: str) -> GpuArray:
        composed = self._scratch.image(name, fine.shape[:2])
        buffers = {"fine": fine, "coarse": coarse, "composed": composed}
        dispatch("frame/compose", fine.shape[1::-1], buffers, **self._pool)
        return composed

    def _pick(self, levels: list[GpuArray], scale: int, composed: GpuArray, coarse: GpuArray) -> None:
        buffers, kernel = {"composed": composed, "coarse": coarse}, self._heads.kernel(scale, "pick")
        self._predict("frame/pick", levels, scale, ("pick", "pick_share"), buffers, KERNEL=kernel)

    def _over_time(
        self,
        name: str,  # of the shader, which includes giving_way.glsl
        levels: list[GpuArray],
        heads: tuple[str, ...],
        buffers: dict[str, GpuArray],
        turned: GpuArray | None,
        parameters: Mapping[str, float] | None = None,
        **options,  # as of `_predict`
    ) -> None:
        """A pass at full size in which history gives way where surfaces have turned."""
        buffers = buffers | {"turned": turned or levels[0]}  # which is not read
        self._predict(name, levels, 0, heads, buffers, parameters, TURNS=int(turned is not None), **options)

    def _predict(
        self,
        name: str,  # of the shader, which includes head.glsl
        levels: list[GpuArray],
        scale: int,
        heads: tuple[str, ...],  # the rows that it computes, one after the other
        buffers: dict[str, GpuArray],  # beside those of head.glsl; the first one has the size of the pass
        parameters: Mapping[str, float] | None = None,
        size: tuple[int, int] | None = None,  # (W, H) of the pass, otherwise that of the first buffer, an image
        **constants: int,
    ) -> None:
        """A pass that computes rows of the last layer at the pixel where it uses them."""
        head = self._heads.layer(scale, *heads)
        cell = 2 if head.weights.shape[0] == 4 else 1  # side of the square of pixels that one feature predicts
        features = levels[max(0, scale - 1) if self._accumulates else scale]  # accumulated_kpn runs at half size
        size = size or next(iter(buffers.values())).shape[1::-1]
        buffers = {"features": features, "weights": head.weights, "biases": head.biases, **buffers}
        parameters = {"feature_size": features.shape[2:0:-1], "groups": head.groups[0], **(parameters or {})}
        constants |= {"CELL": cell, "ROWS": head.outputs, "HALF": int(self._scratch.half)}
        dispatch(name, size, buffers, parameters, **constants)
