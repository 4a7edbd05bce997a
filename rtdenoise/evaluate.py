"""Error and time of several methods on one sequence with reference, in one run."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from . import motion
from .baselines import Accumulate, Oidn, Svgf, Trmv
from .color import display_exposure
from .errors import InputError
from .frame import Frame, sanitise
from .metrics import psnr, relmse, ssim
from .models import load

Step = Callable[[Frame, object], tuple[Tensor, object]]
METHODS: dict[str, Callable[[], Step]] = {
    "noisy": lambda: lambda frame, history: (sanitise(frame).radiance, None),
    "accumulate": lambda: Accumulate().step,
    "accumulate-clamped": lambda: Accumulate(clamp=0.5).step,
    "svgf": lambda: Svgf().step,
    "trmv": lambda: Trmv().step,
    "oidn": lambda: Oidn().step,
    "paper": lambda: load("paper").step,
    "paper-traditional": lambda: load("paper", motion="traditional").step,  # the same weights, without dual motion
}
REGIONS = ("frame", "uncovered")
METRICS = ("psnr", "ssim", "relmse")


@dataclass
class Result:
    """One method on one sequence. `errors[region][metric]` is the mean over frames, weighted by the region's pixels in
    each."""

    method: str
    errors: dict[str, dict[str, float]]
    seconds: float  # median time of one step
    images: list[Tensor] = field(default_factory=list, repr=False)  # [1, 3, H, W] a frame


@torch.inference_mode()
def evaluate(frames: list[Frame], methods: Sequence[str], skip: int = 1) -> list[Result]:
    """Run every method over `frames` (consecutive, with `reference`) and measure it against the reference.

    The first `skip` frames are run but not measured: they have no history yet. Display metrics use one exposure for
    the sequence (`color.display_exposure` of all references); the uncovered region is `motion.occlusion_mask` of each
    frame. Raises InputError for an unknown method, or where references or motion are missing.
    """
    unknown = [name for name in methods if name not in METHODS]
    if unknown:
        raise InputError(f"unknown method {unknown[0]!r}; expected some of {', '.join(METHODS)}")
    for frame in frames:
        frame.require("reference", "motion")
    scale = display_exposure(torch.cat([frame.reference for frame in frames]))
    masks = uncovered(frames)
    return [_run(name, frames, masks, scale, skip) for name in methods]


def uncovered(frames: list[Frame]) -> list[Tensor]:
    """M_i of every frame, `[1, 1, H, W]` bool; empty for the first and where `motion_next` is not known."""
    before = [None, *(frame.motion_next for frame in frames[:-1])]
    return [motion.uncovered(frame, motion_next) for frame, motion_next in zip(frames, before, strict=True)]


def _run(name: str, frames: list[Frame], masks: list[Tensor], scale: Tensor, skip: int) -> Result:
    step, history = METHODS[name](), None
    seconds, images = [], []
    values: dict[tuple[str, str], list[float]] = {(region, metric): [] for region in REGIONS for metric in METRICS}
    pixels: dict[str, list[int]] = {region: [] for region in REGIONS}
    for i, (frame, mask) in enumerate(zip(frames, masks, strict=True)):
        started = time.perf_counter()
        image, history = step(frame, history)
        seconds.append(time.perf_counter() - started)
        images.append(image)
        if i < skip:
            continue
        for region, inside in (("frame", None), ("uncovered", mask)):
            pixels[region].append(mask.numel() if inside is None else int(mask.sum()))
            values[region, "psnr"].append(psnr(image, frame.reference, scale, inside))
            values[region, "ssim"].append(ssim(image, frame.reference, scale, inside))
            values[region, "relmse"].append(relmse(image, frame.reference, scale, inside, frame.reference_half))
    errors = {
        region: {metric: _mean(values[region, metric], pixels[region]) for metric in METRICS} for region in REGIONS
    }
    return Result(name, errors, float(np.median(seconds)), images)


def _mean(values: list[float], weights: list[int]) -> float:
    """Weighted mean of the frames that have pixels; NaN where none has."""
    pairs = [(v, w) for v, w in zip(values, weights, strict=True) if w]
    return float(np.average([v for v, _ in pairs], weights=[w for _, w in pairs])) if pairs else float("nan")
