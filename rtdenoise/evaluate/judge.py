"""What a sequence's images are measured against: its references, metrics and regions."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from torch import Tensor

from .. import metrics as measures
from ..frame import Frame
from ..metrics.image import decibels_of_estimate, masked_mean
from ..metrics.video import ages
from .sequence import Frames

# Regions of errors: the frame; pixels uncovered in it, one and two frames before (M⁰, M¹, M² of the paper).
ALL_REGIONS = ("frame", "uncovered", "uncovered-1", "uncovered-2")
ALL_METRICS = (
    "psnr", "psnr_corrected", "ssim", "relmse", "flip", "smape", "l1", "mse", "mse_corrected", "tpsnr",
    "tpsnr_corrected", "tmse_corrected", "temporal_relmae",
)  # fmt: skip
OVER_TIME = ("tpsnr", "tpsnr_corrected", "tmse_corrected", "temporal_relmae")  # a first frame has none
MEAN_SQUARES = {"psnr_corrected": "mse_corrected", "tpsnr_corrected": "tmse_corrected"}  # of these decibels
WHOLE_METRICS = ("fovvideovdp",)  # of a whole sequence, over the frame only


@dataclass(frozen=True)
class Judge:
    """The references of a sequence, and the metrics and regions to measure."""

    frames: Sequence[Frame]
    masks: list[Tensor]  # `uncovered` of the frames
    scale: Tensor  # exposure of all frames
    skip: int
    metrics: tuple[str, ...]
    regions: tuple[str, ...]

    @classmethod
    def of(cls, frames: Sequence[Frame], skip: int, metrics: tuple[str, ...], regions: tuple[str, ...]) -> Judge:
        frames = Frames.of(frames)
        return cls(frames, frames.uncovered, frames.exposure, skip, metrics, regions)

    def ages(self) -> Iterable[Tensor | None]:
        """`metrics.ages` of each frame; a single frame has none."""
        return ages((frame.motion for frame in self.frames), self.masks) if len(self.frames) > 1 else [None]

    def errors(self, images: list[Tensor], i: int) -> dict[str, dict[str, float]]:
        """region -> metric -> error of the image of frame i, which comes after that of the frame before, if any."""
        errors = _errors(images, self.frames[i + 1 - len(images) : i + 1], self.scale, self._of_frames)
        return {region: {m: error(self._mask(region, i)) for m, error in errors.items()} for region in self.regions}

    def overall(self, frames: list[dict]) -> dict[str, dict[str, float]]:
        """region -> metric -> error of all measured frames, from the errors of each."""
        measured = range(self.skip, len(self.frames))
        weights = {region: [self._pixels(region, i) for i in measured] for region in self.regions}
        first = {m: int(m in OVER_TIME and self.skip == 0) for m in self.metrics}  # of the frames that have the metric
        return {
            region: {m: _overall(m, [f[region] for f in frames[k:]], weights[region][k:]) for m, k in first.items()}
            for region in self.regions
        }

    @property
    def of_whole(self) -> bool:
        """Whether a metric needs the whole sequence."""
        return "fovvideovdp" in self.metrics and "frame" in self.regions

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
