"""A whole frame on the GPU: `TemporalKPN.step`, `AccumulatedKPN.step` and `Hybrid.step_and_kernels` as compute shaders,
without torch.

    pipeline, history = Pipeline.load(), None
    for frame in frames:                                     # rtdenoise.frame.Frame of numpy arrays
        image, history = pipeline.step(frame, history)       # [1, 3, H, W]

Read `Pipeline.run` first: it is the order of the passes. Between upload and download nothing leaves the GPU.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import wraps
from pathlib import Path

import moderngl
import numpy as np

from ..constants import RECALL_RESET
from ..errors import InputError
from ..frame import NOTHING_KNOWN, Frame, Known, expect_history
from ..models.presets import AccumulatedKPNConfig, Config
from ..models.weights import read_denoiser
from .advance import Advance
from .clock import Clock
from .context import GpuArray, GpuMemoryError, default_context
from .current import current
from .follow import Follow
from .kernels import Kernels
from .passes import Means, Passes
from .pixels import Pixels
from .scratch import Scratch
from .state import History

SHADED = ("temporal_kpn", "accumulated_kpn", "hybrid")  # architectures


def _in_context(method: Callable) -> Callable:
    """Decorate a method of a pipeline: its context is current meanwhile."""

    @wraps(method)
    def run(self: Pipeline, *arguments, **options):
        with current(self.ctx):
            return method(self, *arguments, **options)

    return run


class Pipeline:
    """A denoiser like those of `rtdenoise.models`, for one context and thread. State is explicit: the history
    that `step` returns goes into the next `step`."""

    def __init__(
        self,
        config: Config,
        tensors: Mapping[str, np.ndarray],  # the model's state dict, float32
        half: bool = False,
        ctx: moderngl.Context | None = None,
    ) -> None:
        """`half` stores the network's activations as float16: half the memory, an eleven-bit mantissa. `ctx` defaults
        to this thread's `default_context`."""
        self.config, self.ctx = config, ctx or default_context()
        self.accumulates = isinstance(config, AccumulatedKPNConfig)  # keeps a running mean of demodulated light
        self.clock: Clock | None = None  # times the stages where one is set
        self.scratch = Scratch(self.ctx, half)  # GPU memory that is kept between frames, beside the weights
        self.passes = Passes(self.scratch, config, tensors)
        self.kernels = Kernels(self.scratch, config, tensors)
        self.advance = Advance(self.scratch)
        self.light = Follow(self.scratch)
        self.pixels = Pixels(self.scratch, config, tensors) if config.architecture == "hybrid" else None

    @classmethod
    def load(
        cls, model: str | Path = "default", half: bool = False, ctx: moderngl.Context | None = None, **overrides
    ) -> Pipeline:
        """As `rtdenoise.load`: a shipped name or a .safetensors file; `overrides` replace fields of its configuration.
        `half`, `ctx`: as for the constructor.

        Raises InputError for an unknown name, a combiner, an unreadable file, weights that do not fit their
        configuration, a network that has no shaders, and where there is no OpenGL 4.3.
        """
        stored = read_denoiser(model, **overrides)
        kind, guided = stored.config.architecture, getattr(stored.config, "guided", False)
        if kind not in SHADED or guided:
            raise InputError(f"{model}: there are no shaders for networks of the kind {kind!r}"
                             f"{' that are guided' if guided else ''}; use the backend torch")  # fmt: skip
        return cls(stored.config, stored.tensors, half, ctx)

    @_in_context
    def step(
        self, frame: Frame, history: History | None = None, known: Known = NOTHING_KNOWN
    ) -> tuple[np.ndarray, History]:
        """Denoise one frame of numpy arrays `[1, C, H, W]`: `[1, 3, H, W]` linear radiance, float32, and the history
        for the next one.

        `frame` needs radiance, albedo, normal, depth and, unless `history` is None, motion. `history=None` starts a
        sequence or resets after a cut. A frame that is `known` to be still or covered takes fewer passes. Raises
        InputError where a layer is missing, the history is of another size, or a buffer would be larger than the device
        allows.
        """
        try:
            with self._stage("upload"):
                layers = self.upload(frame, history)
            result, history = self.run(layers, history, known, frame.more_history, waits=True)
        except GpuMemoryError as error:
            H, W = frame.size
            raise InputError(
                f"{frame.name or 'frame'}: {W}×{H} is too large: {error}; use half precision (--precision fp16), or "
                "torch (--backend torch), which tiles large frames"
            ) from None
        with self._stage("download"):
            image = result.read()
        return image[None], history

    @_in_context
    def mismatch(self, frame: Frame, history: History) -> float:
        """As `history.mismatch`: above `frame.MAX_CUT_MISMATCH` it is another shot, to start with `history=None`. Waits
        for the GPU."""
        layers = self.upload(frame, history)
        surface = self.passes.prepare(layers).surface
        return self.advance.mismatch(self.passes.vectors(layers), surface, history.surface)

    @_in_context
    def run(
        self,
        layers: Mapping[str, GpuArray],
        history: History | None = None,
        known: Known = NOTHING_KNOWN,
        more_history: bool = False,  # of `Frame`
        waits: bool = False,
    ) -> tuple[GpuArray, History]:
        """`step` on layers [C, H, W] that are on the GPU already. The image [3, H, W] is overwritten by the next call,
        the history is not. `waits` for the GPU to tell how far the camera has gone ahead; else nothing is read back."""
        passes, kernels, first = self.passes, self.kernels, history is None
        averages = self.accumulates and not first  # else the means are the frame itself
        follows = averages and history.noisy is not None and not known.on_surfaces
        dual = not first and not known.covered and self.config.motion == "dual"
        with self._stage("features"):
            inputs = passes.prepare(layers, self.accumulates and first, more_history)
            level = passes.recent.level(inputs)
            vectors = passes.vectors(layers)
            looks = waits and not (first or known.still)
            if looks and (by := self.advance.find(vectors, inputs.surface, history.surface)):
                history = self.advance.history(history, by)
        with self._stage("reprojection"):
            chosen = passes.history_motion(vectors, inputs.surface, history) if dual else vectors
            motion, flagged = vectors, dual  # of light; whether `chosen` says what has been uncovered
            noisy = passes.radiance(inputs) if self.accumulates or first else None
            surfaces = self.light.surfaces(inputs, noisy) if averages else None
            if follows:
                before = history.noisy, history.surface, history.shifts[:1]
                moved = self.light.shift(inputs, surfaces, vectors, noisy, *before)
                chosen, flagged = self.light.followed(chosen, moved, dual, "chosen"), True
                motion = self.light.followed(vectors, moved, False, "motion")
            if first:
                past = noisy
            elif known.still and not follows:
                past = history.denoised
            else:
                past = passes.warp(chosen, inputs, history, flagged)
            means = Means(inputs.light, inputs.guide)
            if averages:
                means = passes.reproject(chosen, inputs, history, level, flagged)
            turned = passes.turned(chosen, inputs, history, known.still) if averages else None
            if averages and bool(history.recent) == (self.config.recent > 0):
                past = passes.outdated(inputs, noisy, past, means, turned, len(history.recent))
            if averages and past is not history.denoised:  # a still's, where nothing tells what is outdated
                passes.relight(inputs, past, means)
        with self._stage("features"):
            groups = 4 if first else 6 if dual else 5  # of four features; the others are zero everywhere
            features = passes.features(inputs, past, means, groups)
        with self._stage("network"):
            levels = passes.network(features, groups)
        with self._stage("kernels"):
            mean, reset = inputs.light, None
            if averages:
                mean, reset = kernels.accumulate(levels, inputs.light, means.running, turned)
            now = kernels.filter(levels, mean)
        with self._stage("blend"):
            if self.accumulates:
                now = kernels.texture(levels, now, inputs.guide, means.mean_albedo)
            result, denoised = kernels.blend(levels, past, now, turned)
            passes.keep_even_sky(inputs, result, denoised)
        if self.pixels:
            with self._stage("pixels"):
                seen = shown = passes.recent.see(inputs, past, means.seen, reset, turned)
                if not (first or known.still or self.config.many) and history.recent:
                    shown = passes.recent.over(seen, inputs, vectors, history.recent)
                self.pixels.mix(inputs, past, seen, shown, level, result, denoised)
                passes.keep_even_sky(inputs, result, denoised)
        after = History(denoised, inputs.surface, vectors if "motion_next" in layers else None)
        if self.config.recent:
            with self._stage("reprojection"):
                recent = passes.recent.keep(inputs, motion, "motion" in layers), *(() if first else history.recent)
                if not first:
                    way = vectors, history.surface, chosen if dual else None
                    passes.recent.forget(reset, turned, recent[0], inputs, *way)
            after = replace(after, recent=recent[: self.config.recent])
        if self.accumulates:
            with self._stage("reprojection"):
                if first:
                    found, shifts = self.light.nothing(denoised.shape), (self.light.nothing(denoised.shape),)
                else:
                    found, shifts = self.light.find(inputs, surfaces, vectors, denoised, history)
            shifts = shifts[: self.config.recent + 1]
            after = replace(after, mean=mean, mean_albedo=means.mean_albedo, noisy=noisy, found=found, shifts=shifts)
        return result, after

    @_in_context
    def remember(self, history: History, frames: Sequence[Frame]) -> History:
        """A history with recent frames, the newest first. Those that it has tell the resets."""
        if not frames or not self.accumulates:
            return history
        passes, recent = self.passes, []
        before = noisy = None  # older frames come first here
        for i, frame in reversed([*enumerate(frames[: self.config.recent + 1])]):
            layers = self.upload(frame, None)
            inputs, motion = passes.prepare(layers), passes.vectors(layers)
            noisy_before, noisy = noisy, passes.radiance(inputs)
            if before is not None and "motion" in layers:
                if by := self.advance.find(motion, inputs.surface, before):
                    recent, before = [self.advance.kept(kept, by) for kept in recent], self.advance.surface(before, by)
                told = history.shifts[i + 1 : i + 2]
                seen = self.light.surfaces(inputs, noisy)
                moved = self.light.shift(inputs, seen, motion, noisy, noisy_before, before, told)
                motion = self.light.followed(motion, moved, False, "motion")
            recent.insert(0, passes.recent.keep(inputs, motion, "motion" in layers))
            before = inputs.surface
        recent = recent[: len(history.recent)]
        for kept, its in zip(recent, history.recent, strict=True):
            kept.write_plane(RECALL_RESET, kept.read_plane(RECALL_RESET) | its.read_plane(RECALL_RESET))
        return replace(history, recent=tuple(recent), noisy=noisy)

    @_in_context
    def upload(self, frame: Frame, history: History | None) -> dict[str, GpuArray]:
        """The layers that a step reads, for `run`. Raises InputError where one is missing, or history is of another
        size or kind of model, or none."""
        if not isinstance(frame, Frame):
            raise InputError(
                f"step takes a rtdenoise.Frame of numpy arrays [1, C, H, W], got {type(frame).__name__}; "
                "rtdenoise.Denoiser(backend='glsl') takes arrays [H, W, C]"
            )
        expect_history(history, History)
        if len(frame.radiance) != 1:
            raise InputError(f"{frame.name or 'frame'}: expected one frame at a time, got {len(frame.radiance)}")
        needed = ("albedo", "normal", "depth", *(() if history is None else ("motion",)))
        frame.require(*needed)
        if history is not None and history.size != frame.size:
            raise InputError(
                f"{frame.name or 'frame'}: history is {history.size}, the frame {frame.size}; pass history=None to "
                "start anew"
            )
        if history is not None and not self._continues(history):
            raise InputError("the history is of another kind of model; pass history=None to start anew")
        return {
            layer: GpuArray.upload(self.ctx, array[0])
            for layer, array in frame.layers()
            if layer in ("radiance", "motion", "motion_next", *needed)
        }

    def _continues(self, history: History) -> bool:
        """Whether a history holds what this model reads."""
        words = self.passes.recent.words if self.config.recent else 0
        return self.accumulates == (history.mean is not None) and all(k.shape[0] >= words for k in history.recent)

    def _stage(self, name: str):
        return nullcontext() if self.clock is None else self.clock.stage(name)
