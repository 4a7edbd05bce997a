"""Error and time of several methods on one sequence with references, in one run."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import metrics as measures
from ..errors import InputError
from ..frame import Frame
from ..metrics.video import Ghost
from .judge import ALL_REGIONS, Judge
from .registry import choose
from .sequence import Frames, Step, outputs

REGIONS = ALL_REGIONS[:2]
METRICS = ("psnr", "ssim", "relmse")
OnStep = Callable[[str, int, int], None]  # label, steps done, steps in all


@dataclass
class Result:
    """One method on one sequence.

    `errors[region][metric]` is the mean over frames, weighted by the pixels of the region in each; NaN where the region
    is empty; a first frame has no error over time. `psnr_corrected` is the PSNR of the mean of `mse_corrected`, which
    can be negative in a single frame; `tpsnr_corrected` likewise.
    """

    method: str
    errors: dict[str, dict[str, float]]
    times: list[float]  # seconds of each measured step
    frames: list[dict] = field(default_factory=list, repr=False)  # of each: number, and region -> metric -> error
    ghost_length: float = math.nan  # frames, `metrics.ghost_length`
    images: list = field(default_factory=list, repr=False)  # of each frame what `keep` left: [1, 3, H, W] on the CPU

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
    keep: Callable[[int, Tensor], Any] = lambda i, image: image,  # what the results hold of the image of frame i
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
    judge = Judge.of(frames, min(skip, len(frames) - 1), tuple(metrics), tuple(regions))
    for name, step in steps.items():
        warm_up(step, frames, device, delays.get(name, 0))
    there = Frames(len(frames), lambda i: frames[i].to(device))
    runs = {name: outputs(step, there, delays.get(name, 0)) for name, step in steps.items()}
    measured = {name: _Measured(judge, Result(name, {}, [])) for name in steps}
    for i, age in enumerate(judge.ages()):
        for turn, (name, run) in enumerate(runs.items()):
            output = next(run)
            image = output.image.cpu()
            measured[name].add(i, image, age, output.seconds)
            measured[name].result.images.append(keep(i, image))
            on_step(name, i * len(runs) + turn + 1, len(frames) * len(runs))
    return [of_method.sum_up() for of_method in measured.values()]


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


@dataclass
class _Measured:
    """One method, whose images come one by one; only those that are yet needed are held."""

    judge: Judge
    result: Result
    ghost: Ghost = field(default_factory=Ghost)
    images: list[Tensor] = field(default_factory=list)  # the latest, or all measured ones for a metric of the whole

    def add(self, i: int, image: Tensor, age: Tensor | None, seconds: float) -> None:
        """Measure the image of frame i."""
        judge = self.judge
        if age is not None:
            self.ghost.add(image, judge.frames[i].reference, age, judge.scale)
        before = self.images[-1:]
        if i >= judge.skip:
            self.result.times.append(seconds)
            self.result.frames.append({"number": judge.frames[i].number} | judge.errors([*before, image], i))
        self.images = [*(self.images if judge.of_whole and i > judge.skip else []), image]

    def sum_up(self) -> Result:
        """The result of all frames."""
        judge, result = self.judge, self.result
        result.errors = judge.overall(result.frames)
        if judge.of_whole and result.frames:
            references = [judge.frames[i].reference for i in range(judge.skip, len(judge.frames))]
            result.errors["frame"]["fovvideovdp"] = measures.fovvideovdp(self.images, references, judge.scale)
        result.ghost_length = self.ghost.length if len(judge.frames) > 1 else math.nan
        return result
