"""Denoise a sequence of EXR files into a folder: `rtdenoise denoise SEQ --out DIR`. Interrupted runs go on where they
stopped, finished ones where frames have been appended."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from .atomic import write_atomically
from .backends import Backend, open_backend
from .data.output import check_output, write_frame
from .data.sequences import Sequence, open_sequence
from .errors import InputError
from .frame import non_finite
from .stored import find

STATE = ".rtdenoise-state.safetensors"  # in the output folder: the history after the last finished frame


@dataclass(frozen=True)
class Options:
    """What a run depends on, beside its input."""

    signal: str = "color"
    """What is denoised: 'color' (the beauty) or 'indirect'."""
    model: str = "paper"
    """Name of a shipped model, or a .safetensors file that `rtdenoise train` wrote."""
    preset: str = "auto"
    """Layout of the input: 'auto', 'native', 'cycles', 'mitsuba', 'falcor', 'bmfr', 'oidn', 'noisebase', or a .toml
    file."""
    layout: str = "plain"
    """Of the output: 'plain' (the result in R,G,B) or 'source' (a copy of the input with the result in its place)."""
    recombine: bool = False
    """Put the denoised signal back together with the rest of the light: the result is the beauty."""
    keep: tuple[str, ...] = ()
    """Channels of the input to pass on, by layer name ('albedo', 'depth' ...) or 'all'."""
    float32: bool = False
    """Write 32-bit float instead of 16-bit half."""
    allow_gaps: bool = False
    """Accept missing frame numbers; history starts anew after each gap."""
    backend: str = "auto"
    """'torch', 'glsl' (OpenGL compute shaders, needs no PyTorch), or 'auto': torch where it is installed."""
    device: str = "auto"
    """Of the backend torch: 'auto', 'cpu' or 'cuda'."""
    precision: str = "auto"
    """Of the network: 'fp32', 'bf16' (torch), 'fp16' (glsl: of what it stores), or 'auto' (torch: bf16 where the
    hardware is faster in it; glsl: fp32)."""


@dataclass
class Summary:
    """What a run did."""

    written: int = 0
    skipped: int = 0
    seconds: float = 0.0  # in the denoiser alone
    replaced: dict[str, int] | None = None  # layer -> pixels that were NaN or Inf


def denoise(
    source: str,
    out: str | Path,
    options: Options = Options(),
    overwrite: bool = False,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Summary:
    """Denoise every frame of `source` (folder or glob) into `out`, one file of the same name each; see `data.output`
    for what is in it.

    Frames that an earlier run with the same options has finished are skipped, and history goes on from its saved
    state, so the outcome is that of one undisturbed run: also where it was interrupted, and where frames have been
    appended to the input since. `on_frame(done, total)` is called at the start and after each frame.

    Raises InputError for anything wrong with the input, the options or the output folder.
    """
    sequence = open_sequence(source, signal=options.signal, preset=options.preset, allow_gaps=options.allow_gaps)
    sequence.require("albedo", "normal", "depth", *(("motion",) if len(sequence) > 1 else ()))
    check_output(sequence, options.layout, options.recombine, options.keep)
    backend = open_backend(options.backend, options.model, options.device, options.precision)
    out = _prepare(Path(out), sequence)
    fingerprints = _fingerprints(sequence, options)
    done, history = (0, None) if overwrite else _resume(out, sequence, fingerprints, backend)

    if not done:
        _save_state(out / STATE, {}, 0, fingerprints[0])  # so that the next run knows the first frame for its own
    summary = Summary(skipped=done, replaced={})
    on_frame(done, len(sequence))
    for i in range(done, len(sequence)):
        frame = sequence.read(i)
        for layer, count in non_finite(frame).items():
            summary.replaced[layer] = summary.replaced.get(layer, 0) + count
        if i and frame.number != sequence.numbers[i - 1] + 1:
            history = None
        started = time.perf_counter()
        image, history = backend.step(frame, history)
        summary.seconds += time.perf_counter() - started
        write_frame(out, sequence, i, frame, image, layout=options.layout, recombine=options.recombine,
                    keep=options.keep, float32=options.float32)  # fmt: skip
        _save_state(out / STATE, backend.save(history), i + 1, fingerprints[i + 1])
        summary.written += 1
        on_frame(i + 1, len(sequence))
    return summary


def _prepare(out: Path, sequence: Sequence) -> Path:
    """The output folder, made if need be; never one that holds the input."""
    if out.resolve() in {path.resolve().parent for path in _inputs(sequence)}:
        raise InputError(f"{out}: this folder holds the input, which is never written to; choose another --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".rtdenoise-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"{out}: cannot write there: {error.strerror}") from None
    return out


def _inputs(sequence: Sequence) -> list[Path]:
    return [path for frame in sequence.files for path in frame.files.values()]


def _fingerprints(sequence: Sequence, options: Options) -> list[str]:
    """Tells runs apart that would write different files: entry k is for the first k frames, whatever comes after."""
    parts = {f.name: getattr(options, f.name) for f in fields(options) if f.name not in ("backend", "device")}
    parts["layers"] = [repr(sequence.rules), repr(sequence.preset)]  # a preset of one's own may have been mended
    parts["weights"] = hashlib.sha256(find(options.model).read_bytes()).hexdigest()
    scene = sequence.scene or {}
    parts["scene"] = {key: value for key, value in scene.items() if key != "frames"}
    cameras = {entry["number"]: entry for entry in scene.get("frames", ())}
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True, default=list).encode())
    fingerprints = [digest.hexdigest()]
    for frame in sequence.files:
        inputs = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in frame.files.values()]
        seen = [cameras.get(frame.number + step) for step in (-1, 0, 1)]  # what its motion is computed from
        digest.update(json.dumps([inputs, seen], sort_keys=True).encode())
        fingerprints.append(digest.hexdigest())
    return fingerprints


def _resume(out: Path, sequence: Sequence, fingerprints: list[str], backend: Backend) -> tuple[int, Any]:
    """How many frames are finished, and the history after them."""
    if not (out / STATE).exists():
        clash = [name for name in sequence.names if (out / name).exists()]
        if clash:
            raise InputError(
                f"{out / clash[0]}: exists and is not from an earlier run; choose another --out or pass --overwrite"
            )
        return 0, None
    try:
        with safe_open(out / STATE, framework="numpy") as file:
            metadata = file.metadata() or {}
            done = int(metadata.get("done", 0))
            if not done:  # whatever is there is of a run that did not come as far as its second frame
                return 0, None
            history = backend.restore({name: file.get_tensor(name) for name in file.keys()})  # noqa: SIM118 (no dict)
    except (SafetensorError, OSError, TypeError, KeyError) as error:
        raise InputError(f"{out / STATE}: not readable ({error}); pass --overwrite to start anew") from None
    if done > len(sequence) or metadata.get("fingerprint") != fingerprints[done]:
        raise InputError(
            f"{out}: holds frames of a run with other options or input; choose another --out or pass --overwrite"
        )
    if any(not (out / name).exists() for name in sequence.names[:done]):
        return 0, None
    return done, history


def _save_state(path: Path, history: dict[str, np.ndarray], done: int, fingerprint: str) -> None:
    write_atomically(path, save(history, metadata={"done": str(done), "fingerprint": fingerprint}))
