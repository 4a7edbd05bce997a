"""Denoise a sequence of EXR files into a folder: `rtdenoise denoise SEQ --out DIR`. Interrupted runs go on where they
stopped."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from .data.output import check_output, write_frame
from .data.sequences import Sequence, open_sequence
from .errors import InputError
from .frame import History, faults
from .models import find, load

STATE = ".rtdenoise-state.safetensors"  # in the output folder: the history after the last finished frame


@dataclass(frozen=True)
class Options:
    """What a run depends on, beside its input."""

    signal: str = "color"
    """What is denoised: 'color' (the beauty) or 'indirect'."""
    model: str = "paper"
    """Name of a shipped model, or a .safetensors file that `rtdenoise train` wrote."""
    preset: str = "auto"
    """Layout of the input: 'auto', 'native', 'cycles', 'mitsuba', 'falcor', 'bmfr', 'oidn', or a .toml file."""
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
    device: str = "auto"
    """'auto', 'cpu' or 'cuda'."""


@dataclass
class Summary:
    """What a run did."""

    written: int = 0
    skipped: int = 0
    seconds: float = 0.0  # in the denoiser alone
    replaced: dict[str, int] | None = None  # "layer: what was wrong" -> pixels (`frame.faults`)


@torch.inference_mode()
def denoise(
    source: str,
    out: str | Path,
    options: Options = Options(),
    overwrite: bool = False,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Summary:
    """Denoise every frame of `source` (folder or glob) into `out`, one file of the same name each; see `data.output`
    for what is in it.

    Frames that an interrupted run with the same options has finished are skipped, and history goes on from its saved
    state, so the outcome is that of an undisturbed run. `on_frame(done, total)` is called at the start and after each
    frame.

    Raises InputError for anything wrong with the input, the options or the output folder.
    """
    sequence = open_sequence(source, signal=options.signal, preset=options.preset, allow_gaps=options.allow_gaps)
    sequence.require("albedo", "normal", "depth", *(("motion",) if len(sequence) > 1 else ()))
    check_output(sequence, options.layout, options.recombine, options.keep)
    if options.device not in ("auto", "cpu", "cuda"):
        raise InputError(f"unknown device {options.device!r}; expected 'auto', 'cpu' or 'cuda'")
    device = options.device if options.device != "auto" else "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("device cuda: no CUDA device was found; use --device cpu")
    denoiser = load(options.model, device)
    out = _prepare(Path(out), sequence)
    fingerprint = _fingerprint(sequence, options)
    done, history = (0, None) if overwrite else _resume(out, sequence, fingerprint, device)

    summary = Summary(skipped=done, replaced={})
    on_frame(done, len(sequence))
    for i in range(done, len(sequence)):
        frame = sequence[i]
        for what, count in faults(frame).items():
            summary.replaced[what] = summary.replaced.get(what, 0) + count
        if i and frame.number != sequence.numbers[i - 1] + 1:
            history = None
        started = time.perf_counter()
        image, history = denoiser.step(frame.to(device), history)
        image = image.cpu()
        summary.seconds += time.perf_counter() - started
        write_frame(out, sequence, i, frame, image, layout=options.layout, recombine=options.recombine,
                    keep=options.keep, float32=options.float32)  # fmt: skip
        _save_state(out / STATE, history, i + 1, fingerprint)
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


def _fingerprint(sequence: Sequence, options: Options) -> str:
    """Tells runs apart that would write different files."""
    parts = {f.name: getattr(options, f.name) for f in fields(options) if f.name != "device"}
    parts["layers"] = [repr(sequence.rules), repr(sequence.preset)]  # a preset of one's own may have been mended
    parts["scene"] = sequence.scene
    parts["inputs"] = [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in _inputs(sequence)]
    parts["weights"] = hashlib.sha256(find(options.model).read_bytes()).hexdigest()
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=list).encode()).hexdigest()


def _resume(out: Path, sequence: Sequence, fingerprint: str, device: str) -> tuple[int, History | None]:
    """How many frames are finished, and the history after them."""
    if not (out / STATE).exists():
        clash = [path.name for path in sequence.paths if (out / path.name).exists()]
        if clash:
            raise InputError(
                f"{out / clash[0]}: exists and is not from an earlier run; choose another --out or pass --overwrite"
            )
        return 0, None
    try:
        with safe_open(out / STATE, framework="pt", device=device) as file:
            metadata = file.metadata() or {}
            stored = set(file.keys())
            names = [f.name for f in fields(History)]
            history = History(**{name: file.get_tensor(name) if name in stored else None for name in names})
    except (SafetensorError, OSError, TypeError) as error:
        raise InputError(f"{out / STATE}: not readable ({error}); pass --overwrite to start anew") from None
    if metadata.get("fingerprint") != fingerprint:
        raise InputError(
            f"{out}: holds frames of a run with other options or input; choose another --out or pass --overwrite"
        )
    done = int(metadata["done"])
    if any(not (out / path.name).exists() for path in sequence.paths[:done]):
        return 0, None
    return done, history


def _save_state(path: Path, history: History, done: int, fingerprint: str) -> None:
    tensors = {
        f.name: t.detach().cpu().contiguous() for f in fields(history) if (t := getattr(history, f.name)) is not None
    }
    temporary = path.with_suffix(".tmp")
    save_file(tensors, temporary, metadata={"done": str(done), "fingerprint": fingerprint})
    temporary.replace(path)
