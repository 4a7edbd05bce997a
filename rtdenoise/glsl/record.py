"""The dispatches of one frame, recorded: shaders, buffers by name, parameters, and checks of everything written."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ..frame import RECENT, SHIFTS, Frame
from .context import GpuArray
from .dispatch import Dispatch, fill, watching
from .pipeline import Pipeline
from .state import History

BEFORE = "_before"  # ends the names of the previous frame's history
UNKNOWN = 1e30  # greater values stand for "none", and are left out of statistics
PROBES = 16  # values of an array that its check lists


@dataclass(frozen=True)
class Step:
    """One dispatch, and checks of the buffers that it wrote."""

    call: Dispatch
    checks: dict[str, dict]  # buffer of the shader -> `check`


@dataclass
class Recording:
    """The dispatches of one frame in order, and the names of the buffers that they use."""

    steps: list[Step] = field(default_factory=list)
    inputs: dict[str, GpuArray] = field(default_factory=dict)  # layers of the frame
    written: dict[str, GpuArray] = field(default_factory=dict)  # history that this frame leaves
    read: dict[str, GpuArray] = field(default_factory=dict)  # history of the frame before
    image: np.ndarray | None = None  # [3, H, W]: the result

    def name(self, array: GpuArray) -> str:
        """The name of a buffer: that of the layer or the history it holds, else its label."""
        for arrays, end in ((self.written, ""), (self.read, BEFORE), (self.inputs, "")):
            for name, other in arrays.items():
                if other.buffer is array.buffer:
                    return name + end
        return array.label


def record(pipeline: Pipeline, frames: list[Frame]) -> list[Recording]:
    """Denoise frames and record each of them. Buffers hold zeros before their first use, so that the unwritten parts of
    an array are the same in every run. Raises InputError as `Pipeline.step`.

    A frame with history looks up as many recent frames as the model keeps, empty ones where there are fewer: every
    path must end at the first frame, which must have no motion.
    """
    used: set[int] = set()  # GL names of buffers; the recordings keep these alive, so no name comes twice
    recordings, history = [], None
    for frame in frames:
        layers = pipeline.upload(frame, history)
        recording = Recording(inputs=layers, read=_images(history))
        with watching(pipeline.ctx, partial(_recorded, recording.steps, used)):
            result, history = pipeline.run(layers, history)
        recording.written, recording.image = _written(history), result.read()
        recordings.append(recording)
        history = with_empty_frames(history, pipeline.config.recent)
    return recordings


@contextmanager
def _recorded(steps: list[Step], used: set[int], call: Dispatch) -> Iterator[None]:
    """Append a dispatch to `steps` after it has run."""
    access = dict(zip(call.program.source.buffers, call.program.source.access, strict=True))
    for name, array in call.buffers.items():
        if access[name] == "writes" and array.buffer.glo not in used:
            array.buffer.clear()
        used.add(array.buffer.glo)
    yield
    steps.append(Step(call, {name: check(call.buffers[name].read()) for name in access if access[name] != "reads"}))


def check(values: np.ndarray) -> dict:
    """Facts to compare an array by: the CRC-32 of its bytes, which another driver's rounding changes, and statistics
    and single values, which it hardly does. Positions count values from the start of the array."""
    flat = values.reshape(-1)
    at = np.linspace(0, flat.size - 1, min(PROBES, flat.size)).astype(int)
    exact = flat.astype(np.float64)
    known = exact[np.abs(exact) < UNKNOWN]
    return {
        "crc32": zlib.crc32(np.ascontiguousarray(values)),
        "mean": float(known.mean()) if known.size else 0.0,
        "rms": float(np.sqrt(np.mean(known**2))) if known.size else 0.0,
        "values": {str(i): float(exact[i]) for i in at},
    }


def _images(history: History | None) -> Mapping[str, GpuArray]:
    fields, recent = ({}, ()) if history is None else (vars(history), history.recent)
    images = {name: array for name, array in fields.items() if isinstance(array, GpuArray)}
    images |= {f"{RECENT}{i}": kept for i, kept in enumerate(recent)}
    if history and history.shifts:  # older ones are not read
        images[f"{SHIFTS}0"] = history.shifts[0]
    return images


def _written(history: History) -> Mapping[str, GpuArray]:
    """What a frame has written of its history: of recent frames itself alone."""
    return _images(replace(history, recent=history.recent[:1]))


def with_empty_frames(history: History, count: int) -> History:
    """A history with so many recent frames; those that it lacks are empty, and nothing is found in them."""
    empty = []
    for _ in range(count - len(history.recent)):
        empty.append(GpuArray.empty(history.denoised.buffer.ctx, history.recent[0].shape, np.uint32))
        fill(empty[-1])
    return replace(history, recent=(*history.recent, *empty))
