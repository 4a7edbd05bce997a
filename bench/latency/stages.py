"""Where the time and the bytes of one step go: a model's functions, timed by the stages that the paper reports."""

from __future__ import annotations

import functools
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from rtdenoise.models import footprint, past

STAGES = {
    "features + kernel prediction": ("demodulate", "features", "predict", "forward"),  # forward: of `hybrid`'s pixels
    "kernel application": ("apply_kernel", "downsample", "compose", "pick", "blend_history"),
    "blending": ("accumulate", "modulate", "blend", "evened", "expand_within", "mix"),
    "reprojection": ("history_motion", "warp", "reproject", "scattered", "recall", "keep", "over", "over_and_coverage"),
}


@dataclass
class Ledger:
    """Seconds of one step by stage, and the least bytes that the stage's functions must read and write."""

    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    bytes: dict[str, int] = field(default_factory=lambda: dict.fromkeys(STAGES, 0))


@contextmanager
def staged(model: nn.Module, synchronise: Callable[[], None]) -> Iterator[Ledger]:
    """Fill a ledger while the model's `step` runs inside this context. Of nested calls only the outermost counts.

    Bytes are those of the tensors that a stage's functions take and return, each counted once per call. The functions
    are those of the model, of its file and those of its bases, of `models.footprint` and of `models.past`.
    """
    files = [sys.modules[kind.__module__] for kind in type(model).__mro__ if kind.__module__.startswith("rtdenoise.")]
    pixels = [model.pixels] if hasattr(model, "pixels") else []
    ledger, owners, running = Ledger(), (model, *pixels, *files, footprint, past), []

    def timed(stage: str, function: Callable) -> Callable:
        @functools.wraps(function)
        def call(*arguments, **named):
            if running:
                return function(*arguments, **named)
            running.append(stage)
            synchronise()
            start = time.perf_counter()
            result = function(*arguments, **named)
            synchronise()
            ledger.seconds[stage] += time.perf_counter() - start
            ledger.bytes[stage] += _bytes((arguments, named, result))
            running.pop()
            return result

        return call

    replaced = []
    for stage, names in STAGES.items():
        found = [(owner, name) for owner in owners for name in names if hasattr(owner, name)]
        if not found:
            raise ValueError(f"{type(model).__name__} has none of the functions of stage '{stage}': {', '.join(names)}")
        for owner, name in found:
            function = getattr(owner, name)
            replaced.append((owner, name, function))
            setattr(owner, name, timed(stage, function))
    try:
        yield ledger
    finally:
        for owner, name, function in replaced:
            if isinstance(owner, nn.Module):
                delattr(owner, name)  # uncovers the method
            else:
                setattr(owner, name, function)


def prediction_flop(step: Callable[[], object]) -> int:
    """Floating-point operations of a step's convolutions; a multiplication and an addition count as two.

    The model must run torch's own convolutions: those that `models.inference.prepare` fuses are not counted.
    """
    with FlopCounterMode(display=False) as counter:
        step()
    return counter.get_total_flops()


def peak_bytes(step: Callable[[], object], device: str) -> int:
    """Peak memory of the tensors that one step makes. Memory that libraries take for themselves is not counted."""
    if device == "cuda":
        torch.cuda.synchronize()
        torch.cuda.reset_peak_memory_stats()
        before = torch.cuda.memory_allocated()
        step()
        return torch.cuda.max_memory_allocated() - before
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU], profile_memory=True) as profile:
        result = step()
    del result
    held = most = 0
    events = (e for e in profile.profiler.kineto_results.events() if e.name() == "[memory]")
    for event in sorted(events, key=lambda e: e.start_ns()):
        held += event.nbytes()
        most = max(most, held)
    return most


def _bytes(value: object) -> int:
    if isinstance(value, Tensor):
        return value.numel() * value.element_size()
    if isinstance(value, dict):
        value = tuple(value.values())
    return sum(map(_bytes, value)) if isinstance(value, tuple | list) else 0
