"""Error and time of several methods on one sequence with reference, in one run."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from .. import metrics as measures
from .. import motion
from ..color import display_exposure
from ..frame import Frame
from ..metrics.image import decibels, masked_mean
from .registry import Step, choose

# Where errors are taken: the frame, what was uncovered in it, and what was uncovered one and two frames ago (the
# paper's M⁰, M¹, M²).
ALL_REGIONS = ("frame", "uncovered", "uncovered-1", "uncovered-2")
ALL_METRICS = (
    "psnr", "psnr_corrected", "ssim", "relmse", "flip", "smape", "l1", "mse", "mse_corrected", "tpsnr",
    "temporal_relmae",
)  # fmt: skip
WHOLE_METRICS = ("fovvideovdp",)  # of a whole sequence, over the frame only
REGIONS = ALL_REGIONS[:2]
METRICS = ("psnr", "ssim", "relmse")


@dataclass
class Result:
    """One method on one sequence. `errors[region][metric]` is the mean over frames, weighted by the region's pixels in
    each; NaN where the region has none. `psnr_corrected` is the PSNR of such a mean of `mse_corrected`: in a single
    frame that may be negative."""

    method: str
    errors: dict[str, dict[str, float]]
    times: list[float]  # seconds of each step that is measured
    frames: list[dict] = field(default_factory=list, repr=False)  # of each: number, and region -> metric -> error
    ghost_length: float = float("nan")  # frames, `metrics.ghost_length`
    images: list[Tensor] = field(default_factory=list, repr=False)  # [1, 3, H, W] a frame, on the CPU

    @property
    def seconds(self) -> float:
        """Median time of one step."""
        return float(np.median(self.times))


@torch.inference_mode()
def evaluate(
    frames: Sequence[Frame],  # consecutive, with reference and motion
    methods: Collection[str] | Mapping[str, Step],  # names, or steps under names of one's own
    skip: int = 1,  # first frames that are run but not measured: they have no history yet
    metrics: Collection[str] = METRICS,  # of ALL_METRICS and WHOLE_METRICS
    regions: Collection[str] = REGIONS,  # of ALL_REGIONS
    device: str | torch.device = "cpu",
) -> list[Result]:
    """Run the methods over `frames` in turn, frame by frame, and measure each against the reference.

    Time is wall-clock time around `step`, with everything on the device before and finished after it, in the state
    that a long run has: two frames go through every method first. In turn, so that whatever else the machine does
    falls on all of them alike. Display metrics use one exposure for the sequence (`color.display_exposure` of all
    references). What needs `reference_half` is NaN without. Raises InputError for an unknown method, or where
    references or motion are missing.
    """
    for frame in frames:
        frame.require("reference", "motion")
    named = isinstance(methods, Mapping)
    steps = dict(methods) if named else {method.name: method.step(device) for method in choose(methods)}
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    masks = uncovered(frames)
    of_frames = [metric for metric in metrics if metric not in WHOLE_METRICS]
    if "psnr_corrected" in metrics and "mse_corrected" not in metrics:
        of_frames.append("mse_corrected")  # what it is the PSNR of
    results = {name: Result(name, {}, []) for name in steps}
    for step in steps.values():
        warm_up(step, frames, device)
    histories = dict.fromkeys(steps)
    for i, frame in enumerate(frames):
        on_device = frame.to(device)
        for name, step in steps.items():
            image, histories[name], seconds = _timed(step, on_device, histories[name])
            result = results[name]
            result.images.append(image.cpu())
            if i >= skip:
                result.times.append(seconds)
                errors = _errors(result.images[-2:], frames[max(0, i - 1) : i + 1], scale, of_frames)
                recent = dict(zip(ALL_REGIONS, (None, *measures.recent_masks(masks, i)), strict=True))
                result.frames.append(
                    {"number": frame.number}
                    | {region: {m: error(recent[region]) for m, error in errors.items()} for region in regions}
                )
    for result in results.values():
        weights = {region: [_pixels(masks, i, region) for i in range(skip, len(frames))] for region in regions}
        result.errors = {
            region: {m: _overall(m, [f[region] for f in result.frames], weights[region]) for m in metrics}
            for region in regions
        }
        if "fovvideovdp" in metrics and "frame" in regions and result.frames:
            references = [frame.reference for frame in frames[skip:]]
            result.errors["frame"]["fovvideovdp"] = measures.fovvideovdp(result.images[skip:], references, scale)
        result.ghost_length = _ghost_length(result.images, frames, masks, scale)
    return list(results.values())


def uncovered(frames: Sequence[Frame]) -> list[Tensor]:
    """M_i of every frame, `[1, 1, H, W]` bool; empty for the first and where `motion_next` is not known."""
    before = [None, *(frame.motion_next for frame in frames[:-1])]
    return [motion.uncovered(frame, motion_next) for frame, motion_next in zip(frames, before, strict=True)]


def warm_up(step: Step, frames: Sequence[Frame], device: str | torch.device = "cpu") -> None:
    """Two frames through a method, which shows too whether it takes them at all."""
    history = None
    for frame in frames[:2]:
        _, history = step(frame.to(device), history)


def _timed(step: Step, frame: Frame, history: object) -> tuple[Tensor, object, float]:
    _synchronise(frame)
    started = time.perf_counter()
    image, history = step(frame, history)
    _synchronise(frame)
    return image, history, time.perf_counter() - started


def _synchronise(frame: Frame) -> None:
    if frame.radiance.is_cuda:
        torch.cuda.synchronize(frame.radiance.device)


def _errors(images: list[Tensor], frames: Sequence[Frame], scale: Tensor, wanted: Collection[str]) -> dict:
    """metric -> function of a mask, for the last of one or two consecutive images."""
    image, frame = images[-1], frames[-1]
    now = (image, frame.reference, scale)
    pairs = (tuple(images), tuple(f.reference for f in frames), scale)
    nothing = lambda mask: float("nan")  # noqa: E731 (a first frame has no difference to the one before)

    def corrected(metric: Callable[..., float]) -> Callable[[Tensor | None], float]:
        half = frame.reference_half
        return nothing if half is None else lambda mask: metric(*now, mask, reference_half=half)

    known = {
        "psnr": lambda mask: measures.psnr(*now, mask),
        "psnr_corrected": corrected(measures.psnr_corrected),
        "mse_corrected": corrected(measures.mse_corrected),
        "ssim": lambda mask: measures.ssim(*now, mask),
        "relmse": lambda mask: measures.relmse(*now, mask, frame.reference_half),
        "smape": lambda mask: measures.smape(*now, mask),
        "l1": lambda mask: measures.l1(*now, mask),
        "mse": lambda mask: measures.mse(*now, mask),
        "tpsnr": (lambda mask: measures.tpsnr(*pairs, mask)) if len(images) > 1 else nothing,
        "temporal_relmae": (lambda mask: measures.temporal_relmae(*pairs, mask)) if len(images) > 1 else nothing,
    }
    if "flip" in wanted:  # one map for all regions: it is what takes longest
        differences = measures.flip_map(*now)
        known["flip"] = lambda mask: masked_mean(differences, mask)
    return {metric: known[metric] for metric in wanted}


def _pixels(masks: list[Tensor], i: int, region: str) -> int:
    """How many pixels of frame i are in a region."""
    index = ALL_REGIONS.index(region)
    return masks[i].numel() if index == 0 else int(measures.recent_masks(masks, i)[index - 1].sum())


def _ghost_length(images: list[Tensor], frames: Sequence[Frame], masks: list[Tensor], scale: Tensor) -> float:
    references, motions = [frame.reference for frame in frames], [frame.motion for frame in frames]
    return measures.ghost_length(images, references, motions, masks, scale)


def _overall(metric: str, frames: list[dict[str, float]], weights: list[int]) -> float:
    """The error of a region over all frames, from that in each."""
    if metric in WHOLE_METRICS:
        return math.nan
    if metric == "psnr_corrected":
        mse = _mean([frame["mse_corrected"] for frame in frames], weights)
        return decibels(mse) if mse > 0 else math.nan
    return _mean([frame[metric] for frame in frames], weights)


def _mean(values: list[float], weights: list[int]) -> float:
    """Weighted mean of the frames that have pixels; NaN where none has."""
    pairs = [(v, w) for v, w in zip(values, weights, strict=True) if w]
    return float(np.average([v for v, _ in pairs], weights=[w for _, w in pairs])) if pairs else float("nan")
