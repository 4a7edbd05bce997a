"""Training clips from frames on disk: windows of shots that were rendered with references."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np
import torch

from .. import __version__
from ..data.clip_file import clip_path, read_facts, write_clip
from ..data.clips import SHOT
from ..data.layers import SIGNALS
from ..errors import InputError
from ..evaluate.inputs import Source
from ..evaluate.measure import check_references
from ..evaluate.origin import typed
from ..evaluate.sequence import uncovered
from ..files import dumps, lock, remove_unfinished, stamp, utf8, write_atomically
from ..frame import Frame
from ..run.choice import known_samples
from ..sanitise import sanitise
from ..wording import counted

NEEDED = ("albedo", "normal", "depth", "motion", "motion_next")
DEFAULTS = {"preset": "auto", "reference": ""}  # facts of a clip, and what they are where a set does not tell
FILES = "files"  # fact of a clip: `_digest` of its frames; sets of earlier versions lack it
AT_ONCE = 64  # clips that are cut in one pass over the frames, which bounds memory
CARD = """# Training clips

{clips} of {frames}, {width}×{height}, cut from {shots} by `{command}`.

{lines}

References are those of the shots. Where a shot has no halves of its references, both halves here are the whole
reference and say nothing about its error.
"""


@dataclass(frozen=True)
class CutOptions:
    """What is cut from shots."""

    count: int  # clips at most
    size: tuple[int, int]  # (H, W) of a clip
    frames: int  # of a clip
    seed: int = 0  # of the choice, where shots have more windows than `count`
    preset: str = "auto"
    spp: int = 0  # samples a pixel of frames that do not tell; 0: as noted in the files, or in samples.json, or 1


@dataclass(frozen=True)
class ClipPlace:
    """A clip's place: consecutive frames of a shot, and a rectangle."""

    shot: int
    first: int  # index of its first frame
    top: int
    left: int


def cut_clips(
    shots: tuple[str, ...],
    out: Path,
    options: CutOptions,
    references: tuple[Path, ...] = (),  # a folder a shot with converged frames; (): the layers of the shots
    on_clip: Callable[[int, int], None] = lambda done, total: None,
    say: Callable[[str], None] = print,
) -> int:
    """Cut shots into clips in the folder `out`, and describe them in DATA.md and dataset.json. Returns their number.

    Windows lie side by side, in space and in time; where there are more than `options.count`, a random choice is taken.
    Clips that are there are kept. Raises InputError where a shot is named twice, lacks references or features, is
    smaller or shorter than a clip, or `out` holds clips of other shots or options, or more of them, or of frames that
    were changed since.
    """
    if references and len(references) != len(shots):
        raise InputError(f"--reference: expected a folder for each of {len(shots)} shots, got {len(references)}")
    places = [Path(shot).resolve() for shot in shots]
    if twice := [shot for shot, place in zip(shots, places, strict=True) if places.count(place) > 1]:
        raise InputError(f"{twice[0]}: is named twice")
    opened = [_open(shot, options.preset, *references[i : i + 1]) for i, shot in enumerate(shots)]
    spp = [_samples(sources, options) for sources in opened]
    windows = [window for i, sources in enumerate(opened) for window in _windows(i, sources, options)]
    chosen = np.random.default_rng(options.seed).permutation(len(windows))[: options.count]
    clips = [windows[i] for i in sorted(chosen)]
    for i, sources in enumerate(opened):
        taken = sum(window.shot == i for window in clips)
        frames = counted(len(_first(sources).base), "frame")
        say(f"{shots[i]}: {' and '.join(sources)}; {frames}, {counted(taken, 'clip')}")
    folders = [str(folder.resolve()) for folder in references] or [""] * len(shots)
    files = {(i, first): _digest(opened[i], first, options) for i, first in {(it.shot, it.first) for it in clips}}
    facts = [
        _facts(window, opened[window.shot], options)
        | {"spp": spp[window.shot], "reference": folders[window.shot], FILES: files[window.shot, window.first]}
        for window in clips
    ]
    out.mkdir(parents=True, exist_ok=True)
    with lock(out):
        remove_unfinished(out)
        missing = [i for i in range(len(clips)) if not _is_there(out, i, facts[i])]
        _refuse_more(out, len(clips))
        on_clip(0, len(missing))
        done = 0
        for _, group in groupby(missing, key=lambda i: (clips[i].shot, clips[i].first)):
            numbers = list(group)
            for start in range(0, len(numbers), AT_ONCE):
                part = {i: (clips[i], facts[i]) for i in numbers[start : start + AT_ONCE]}
                _cut(out, part, opened, options)
                done += len(part)
                on_clip(done, len(missing))
        _describe(out, clips, shots, options)
    return len(clips)


def _open(shot: str, preset: str, reference: Path | None = None) -> dict[str, Source]:
    """Signal -> the shot; only the signals that it has with references. Raises InputError where it has neither."""
    found, errors = {}, []
    for signal in SIGNALS:
        try:
            source = Source.open(shot, signal, preset, None, reference)
            source.base.require(*NEEDED)
            found[signal] = source
        except InputError as error:
            errors.append(error)
    if not found:
        raise errors[0]
    return found


def _first(sources: dict[str, Source]) -> Source:
    return next(iter(sources.values()))


def _windows(shot: int, sources: dict[str, Source], options: CutOptions) -> list[ClipPlace]:
    """All windows of a shot, in the order of their frames."""
    source, (height, width) = _first(sources), options.size
    H, W = source.base.size
    if height > H or width > W:
        raise InputError(f"{source.folder}: frames are {W}×{H}, clips {width}×{height}; take a smaller --size")
    firsts = range(0, len(source.base) - options.frames + 1, options.frames)
    if not firsts:
        has = counted(len(source.base), "frame")
        raise InputError(f"{source.folder}: has {has}, clips {options.frames}; take fewer --frames")
    rows, columns = H // height, W // width
    top, left = (H - rows * height) // 2, (W - columns * width) // 2
    return [
        ClipPlace(shot, first, top + row * height, left + column * width)
        for first in firsts
        for row in range(rows)
        for column in range(columns)
    ]


def _samples(sources: dict[str, Source], options: CutOptions) -> float:
    """Samples a pixel of a shot's noisy frames."""
    source = _first(sources)
    return round(known_samples(source.base, options.spp), 2) or source.spp  # a mean in float32 may just miss its value


def _facts(window: ClipPlace, sources: dict[str, Source], options: CutOptions) -> dict:
    """The facts of a clip that are known before it is cut."""
    source = _first(sources)
    return {
        "kind": SHOT, "source": str(source.folder.resolve()), "signals": list(sources), "seed": options.seed,
        "first": source.base.numbers[window.first], "frames": options.frames, "size": list(options.size),
        "window": [window.top, window.left], "preset": options.preset,
    }  # fmt: skip


def _digest(sources: dict[str, Source], first: int, options: CutOptions) -> str:
    """Tells a clip's frames from others of the same numbers, by names, sizes and times of their files."""
    sequences = [it for source in sources.values() for it in (source.base, source.converged) if it]
    frames = [frame for it in sequences for frame in it.files[first : first + options.frames]]
    text = dumps([stamp(path) for frame in frames for path in frame.files.values()])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _is_there(out: Path, number: int, facts: dict) -> bool:
    """Whether the clip is cut already. Raises InputError where another clip has its name, or its frames are others."""
    path = clip_path(out, number)
    if not path.exists():
        return False
    found = DEFAULTS | {FILES: facts[FILES]} | read_facts(path)
    if facts.items() <= found.items():
        return True
    if facts.items() <= (found | {FILES: facts[FILES]}).items():
        raise InputError(f"{path}: its frames were changed since it was cut; remove the clips, or choose another --out")
    raise InputError(f"{path}: is another clip; choose another --out, or the shots and options of that run")


def _refuse_more(out: Path, count: int) -> None:
    """Raise InputError where a folder holds clips of a set of more than `count`: training would take them, too."""
    if more := {*out.glob("clip_*.safetensors")} - {clip_path(out, i) for i in range(count)}:
        raise InputError(f"{min(more)}: is of a set of more clips; choose another --out, or the shots and options of "
                         "that run")  # fmt: skip


def _cut(
    out: Path, clips: dict[int, tuple[ClipPlace, dict]], opened: list[dict[str, Source]], options: CutOptions
) -> None:
    """Cut clips that share their frames: number -> (window, facts known before)."""
    started, (one, _) = time.process_time(), next(iter(clips.values()))
    sources = opened[one.shot]
    layers: dict[int, list[dict[str, np.ndarray]]] = {number: [] for number in clips}
    crops: dict[int, list[Frame]] = {number: [] for number in clips}  # of the first signal
    for i in range(one.first, one.first + options.frames):
        frames = {signal: _read(source, i) for signal, source in sources.items()}
        for number, (window, _) in clips.items():
            parts = {name: frame.crop(window.top, window.left, *options.size) for name, frame in frames.items()}
            layers[number].append(_layers(parts))
            crops[number].append(next(iter(parts.values())).map(torch.clone))
    for number, (_, known) in clips.items():
        facts = known | {
            "index": number, "halves": crops[number][0].reference_half is not None,
            "uncovered": float(torch.cat(uncovered(crops[number])).float().mean()),
            "seconds": (time.process_time() - started) / len(clips), "versions": {"rtdenoise": __version__},
        }  # fmt: skip
        write_clip(clip_path(out, number), layers[number], facts, signals=list(sources))


def _read(source: Source, i: int) -> Frame:
    """Frame i with its references, valid; fireflies stay, for they are part of the noise to learn."""
    frame = replace(source.base[i], **source.references(i))
    check_references([frame])
    radiance = torch.nan_to_num(frame.radiance, nan=0.0, posinf=0.0, neginf=0.0).clamp(min=0)
    return replace(sanitise(frame), radiance=radiance)


def _layers(parts: dict[str, Frame]) -> dict[str, np.ndarray]:
    """Layer of a clip -> [H, W, C], from a frame for each signal. All surfaces are one object: nothing reads ids."""
    one = next(iter(parts.values()))
    tensors = {name: getattr(one, name) for name in NEEDED} | {"id": (one.depth > 0).float()}
    for signal, frame in parts.items():
        for field, name in SIGNALS[signal].items():
            tensors[name] = frame.reference if getattr(frame, field) is None else getattr(frame, field)
    return {name: np.ascontiguousarray(tensor[0].permute(1, 2, 0).numpy()) for name, tensor in tensors.items()}


def _describe(out: Path, clips: list[ClipPlace], shots: tuple[str, ...], options: CutOptions) -> None:
    counts = {shot: sum(window.shot == i for window in clips) for i, shot in enumerate(shots)}
    command = typed()
    height, width = options.size
    card = {"clips": len(clips), "frames_per_clip": options.frames, "size": [height, width], "sources": counts,
            "command": command}  # fmt: skip
    text = CARD.format(
        clips=counted(len(clips), "clip"), frames=counted(options.frames, "frame"), width=width, height=height,
        shots=counted(len(shots), "shot"), command=command,
        lines="\n".join(f"- {shot}: {counted(count, 'clip')}" for shot, count in counts.items()),
    )  # fmt: skip
    write_atomically(out / "dataset.json", dumps(card, indent=2).encode())
    write_atomically(out / "DATA.md", utf8(text))
