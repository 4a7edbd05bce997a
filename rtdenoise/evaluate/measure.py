"""Error and time of several methods on one sequence with references, in one run."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import tee

import numpy as np
import torch
from torch import Tensor

from .. import metrics as measures
from ..color import display_exposure
from ..errors import InputError
from ..frame import Frame
from ..metrics.image import decibels_of_estimate, masked_mean
from .registry import choose
from .sequence import Step, outputs, uncovered

# Regions of errors: the frame; pixels uncovered in it, one and two frames before (M⁰, M¹, M² of the paper).
ALL_REGIONS = ("frame", "uncovered", "uncovered-1", "uncovered-2")
ALL_METRICS = (
    "psnr", "psnr_corrected", "ssim", "relmse", "flip", "smape", "l1", "mse", "mse_corrected", "tpsnr",
    "tpsnr_corrected", "tmse_corrected", "temporal_relmae",
)  # fmt: skip
MEAN_SQUARES = {"psnr_corrected": "mse_corrected", "tpsnr_corrected": "tmse_corrected"}  # of these decibels
WHOLE_METRICS = ("fovvideovdp",)  # of a whole sequence, over the frame only
REGIONS = ALL_REGIONS[:2]
METRICS = ("psnr", "ssim", "relmse")
OnStep = Callable[[str, int, int], None]  # label, steps done, steps in all


@dataclass
class Result:
    """One method on one sequence.

    `errors[region][metric]` is the mean over frames, weighted by the pixels of the region in each; NaN where the region
    is empty. `psnr_corrected` is the PSNR of the mean of `mse_corrected`, which can be negative in a single frame;
    `tpsnr_corrected` likewise.
    """

    method: str
    errors: dict[str, dict[str, float]]
    times: list[float]  # seconds of each measured step
    frames: list[dict] = field(default_factory=list, repr=False)  # of each: number, and region -> metric -> error
    ghost_length: float = math.nan  # frames, `metrics.ghost_length`
    images: list[Tensor] = field(default_factory=list, repr=False)  # [1, 3, H, W] a frame, on the CPU

    @property
    def seconds(self) -> float:
        """Median time of one step."""
        return float(np.median(self.times))


@torch.inference_mode()
def evaluate(
    frames: Sequence[Frame],  # consecutive, with references and, from two frames on, motion
    methods: Collection[str] | Mapping[str, Step],  # names for `choose`, or name -> step
    skip: int = 1,  # first frames that are run but not measured: they have no history; a single frame is measured
    metrics: Collection[str] = METRICS,  # of ALL_METRICS and WHOLE_METRICS
    regions: Collection[str] = REGIONS,  # of ALL_REGIONS
    device: str | torch.device = "cpu",
    delays: Mapping[str, int] | None = None,  # name -> frames that a step looks ahead (`sequence`), for steps
    on_step: OnStep = lambda label, done, total: None,  # called after each step
) -> list[Result]:
    """Run the methods over `frames` and measure each against the references.

    The methods take turns frame by frame, so that other load on the machine slows all of them alike. Time is wall-clock
    time around `step`, with frame and image on the device; two frames go through every method first. Display metrics
    use one exposure for the sequence (`color.display_exposure` of all references). Metrics that need `reference_half`
    are NaN without it. Raises InputError for an unknown method, and where references or motion are missing or
    references are not finite.
    """
    check_references(frames)
    if isinstance(methods, Mapping):
        steps, delays = dict(methods), dict(delays or {})
    else:
        chosen = choose(methods)
        steps = {method.name: method.step(device) for method in chosen}
        delays = {method.name: method.delay for method in chosen}
    judge = _Judge.of(frames, min(skip, len(frames) - 1), tuple(metrics), tuple(regions))
    for name, step in steps.items():
        warm_up(step, frames, device, delays.get(name, 0))
    streams = tee((frame.to(device) for frame in frames), len(steps))
    runs = {
        name: outputs(step, stream, delays.get(name, 0))
        for (name, step), stream in zip(steps.items(), streams, strict=True)
    }
    results = {name: Result(name, {}, []) for name in steps}
    for i in range(len(frames)):
        for turn, (name, run) in enumerate(runs.items()):
            output = next(run)
            results[name].images.append(output.image.cpu())
            judge.add(results[name], i, output.seconds)
            on_step(name, i * len(runs) + turn + 1, len(frames) * len(runs))
    for result in results.values():
        judge.sum_up(result)
    return list(results.values())


def check_references(frames: Sequence[Frame]) -> None:
    """Raise InputError where references are missing or not finite, or motion is missing between frames."""
    for frame in frames:
        frame.require("reference", *(("motion",) if len(frames) > 1 else ()))
        for layer in ("reference", "reference_half"):
            values = getattr(frame, layer)
            if values is not None and (bad := int((~values.isfinite()).any(1).sum())):
                raise InputError(f"{frame.name or f'frame {frame.number}'}: layer {layer}: NaN or Inf in {bad} pixels; "
                                 "errors need finite references: render that frame again")  # fmt: skip


def warm_up(step: Step, frames: Sequence[Frame], device: str | torch.device = "cpu", delay: int = 0) -> None:
    """Run two frames through a method; errors of the method are raised here."""
    for _ in outputs(step, [frame.to(device) for frame in frames[:2]], delay):
        pass


@dataclass(frozen=True)
class _Judge:
    """The references of a sequence, and the metrics and regions to measure."""

    frames: Sequence[Frame]
    masks: list[Tensor]  # `uncovered` of the frames
    scale: Tensor  # exposure of all frames
    skip: int
    metrics: tuple[str, ...]
    regions: tuple[str, ...]

    @classmethod
    def of(cls, frames: Sequence[Frame], skip: int, metrics: tuple[str, ...], regions: tuple[str, ...]) -> _Judge:
        scale = display_exposure(torch.cat([frame.reference for frame in frames]))
        return cls(frames, uncovered(frames), scale, skip, metrics, regions)

    def add(self, result: Result, i: int, seconds: float) -> None:
        """Measure the latest image of `result`, of frame i."""
        if i < self.skip:
            return
        result.times.append(seconds)
        errors = _errors(result.images[-2:], self.frames[max(0, i - 1) : i + 1], self.scale, self._of_frames)
        result.frames.append(
            {"number": self.frames[i].number}
            | {region: {m: error(self._mask(region, i)) for m, error in errors.items()} for region in self.regions}
        )

    def sum_up(self, result: Result) -> None:
        """Fill in the errors over all frames."""
        weights = {region: [self._pixels(region, i) for i in self._measured] for region in self.regions}
        result.errors = {
            region: {m: _overall(m, [f[region] for f in result.frames], weights[region]) for m in self.metrics}
            for region in self.regions
        }
        references = [frame.reference for frame in self.frames]
        if "fovvideovdp" in self.metrics and "frame" in self.regions and result.frames:
            seen = result.images[self.skip :], references[self.skip :]
            result.errors["frame"]["fovvideovdp"] = measures.fovvideovdp(*seen, self.scale)
        if len(self.frames) > 1:
            motions = [frame.motion for frame in self.frames]
            result.ghost_length = measures.ghost_length(result.images, references, motions, self.masks, self.scale)

    @property
    def _measured(self) -> range:
        return range(self.skip, len(self.frames))

    @property
    def _of_frames(self) -> list[str]:
        wanted = [metric for metric in self.metrics if metric not in WHOLE_METRICS]
        return list(dict.fromkeys([*wanted, *(MEAN_SQUARES[m] for m in wanted if m in MEAN_SQUARES)]))

    def _mask(self, region: str, i: int) -> Tensor | None:
        index = ALL_REGIONS.index(region)
        return measures.recent_masks(self.masks, i)[index - 1] if index else None

    def _pixels(self, region: str, i: int) -> int:
        mask = self._mask(region, i)
        return self.masks[i].numel() if mask is None else int(mask.sum())


def _errors(images: list[Tensor], frames: Sequence[Frame], scale: Tensor, wanted: Collection[str]) -> dict:
    """metric -> function of a mask, for the last of one or two consecutive images."""
    image, frame = images[-1], frames[-1]
    now = (image, frame.reference, scale)
    pairs = (tuple(images), tuple(f.reference for f in frames), scale)
    nothing = lambda mask: math.nan  # noqa: E731 (a first frame has no difference to the one before)

    def over_time(metric: Callable[..., float]) -> Callable[[Tensor | None], float]:
        return partial(metric, *pairs) if len(images) > 1 else nothing

    halves = tuple(f.reference_half for f in frames)

    def corrected(metric: Callable[..., float]) -> Callable[[Tensor | None], float]:
        half = frame.reference_half
        return nothing if half is None else lambda mask: metric(*now, mask, reference_half=half)

    def corrected_over_time(metric: Callable[..., float]) -> Callable[[Tensor | None], float]:
        known = len(images) > 1 and all(half is not None for half in halves)
        return partial(metric, *pairs, reference_halves=halves) if known else nothing

    def flip() -> Callable[[Tensor | None], float]:
        differences = measures.flip_map(*now)  # the slowest metric: one map for all regions
        return lambda mask: masked_mean(differences, mask)

    def function(metric: str) -> Callable[[Tensor | None], float]:
        match metric:
            case "flip":
                return flip()
            case "psnr_corrected" | "mse_corrected":
                return corrected(getattr(measures, metric))
            case "tpsnr_corrected" | "tmse_corrected":
                return corrected_over_time(getattr(measures, metric))
            case "tpsnr" | "temporal_relmae":
                return over_time(getattr(measures, metric))
            case "relmse":
                return lambda mask: measures.relmse(*now, mask, frame.reference_half)
            case _:
                return partial(getattr(measures, metric), *now)

    return {metric: function(metric) for metric in wanted}


def _overall(metric: str, frames: list[dict[str, float]], weights: list[int]) -> float:
    """The error of a region over all frames, from its error in each."""
    if metric in WHOLE_METRICS:
        return math.nan
    if metric in MEAN_SQUARES:
        return decibels_of_estimate(_mean([frame[MEAN_SQUARES[metric]] for frame in frames], weights))
    return _mean([frame[metric] for frame in frames], weights)


def _mean(values: list[float], weights: list[int]) -> float:
    """Weighted mean of the frames that have pixels; NaN where none has."""
    pairs = [(v, w) for v, w in zip(values, weights, strict=True) if w]
    return float(np.average([v for v, _ in pairs], weights=[w for _, w in pairs])) if pairs else math.nan
