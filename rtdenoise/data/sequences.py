"""A folder or glob of EXR files, one a frame, as frames: headers are checked up front, pixels read when asked for."""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from glob import glob, has_magic
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from rtdenoise.data.exr import read_channels, read_header
from rtdenoise.data.exr_format import ExrHeader
from rtdenoise.data.presets import SIGNALS, Preset, Rule, find
from rtdenoise.errors import InputError
from rtdenoise.frame import CHANNELS, Frame
from rtdenoise.motion import motion_from_scene

DEFAULT_LAYERS = ("radiance", "albedo", "normal", "depth", "motion", "motion_next")


@dataclass(frozen=True)
class Sequence:
    """Frames in order of their numbers: `len(s)`, `s[i]`, `for frame in s`. Every access reads the file anew.

    Layers that the files do not have are None in the frames, except that `motion` and `motion_next` are computed where
    `position`, `id` and a `scene.json` allow it.
    """

    paths: tuple[Path, ...]
    numbers: tuple[int, ...]  # frame numbers, ascending
    size: tuple[int, int]  # (H, W)
    signal: str
    preset: Preset
    header: ExrHeader = field(repr=False)  # of the first file
    rules: dict[str, Rule]  # layer of `Frame` -> the channels that it is read from; only those that are read
    available: dict[str, Rule] = field(repr=False)  # as `rules`, for everything that could be read
    gaps: tuple[int, ...] = ()  # frame numbers that are missing in between
    scene: dict | None = field(default=None, repr=False)  # scene.json, parsed and checked; None where there is none

    @property
    def demodulated(self) -> bool:
        """Whether the renderer has already divided the signal by the albedo."""
        return self.signal in self.preset.demodulated

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[Frame]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, i: int) -> Frame:
        """Frame i (not the frame with the number i): `[1, C, H, W]` float32 tensors.

        Values are as stored, non-finite ones too, except that the depth of misses (inf, Cycles' 1e10) becomes 0.
        """
        channels = read_channels(self.paths[i], list({name for rule in self.rules.values() for name in rule.channels}))
        layers = {layer: _convert(rule, channels, layer) for layer, rule in self.rules.items()}
        frame = Frame(**layers, number=self.numbers[i], name=str(self.paths[i]))
        return motion_from_scene(frame, self.scene) if self.scene else frame

    def require(self, *layers: str) -> Sequence:
        """The sequence itself, if it has these layers of `Frame`.

        Raises `InputError` naming the file, the first missing layer, what there is, and what to switch on.
        """
        missing = [layer for layer in layers if layer not in self.available and not self._derivable(layer)]
        if missing:
            raise InputError(_missing(self.header, self.preset, self.signal, missing[0]))
        return self

    def _derivable(self, layer: str) -> bool:
        return layer in ("motion", "motion_next") and bool(self.scene) and {"position", "id"} <= self.available.keys()


def open_sequence(
    path_or_glob: str | os.PathLike,  # a folder, a glob, or one file
    *,
    signal: str = "color",  # "color" or "indirect"
    preset: str = "auto",  # "auto", "native", "cycles", "cycles:<ViewLayer>" or "mitsuba"
    layers: Collection[str] | None = None,  # layers of `Frame` to read beside DEFAULT_LAYERS, where the files have them
    allow_gaps: bool = False,  # accept missing frame numbers; they are listed in `Sequence.gaps`
) -> Sequence:
    """Find the files and check all their headers: one size, one set of layers, complete files, consecutive numbers.

    The frame number is the last run of digits in a file's name. Raises `InputError` for whatever does not fit.
    """
    if signal not in SIGNALS:
        raise InputError(f"unknown signal '{signal}': known are {', '.join(SIGNALS)}")
    if unknown := [layer for layer in layers or () if layer not in CHANNELS]:
        raise InputError(f"unknown layer '{unknown[0]}': known are {', '.join(CHANNELS)}")
    paths, numbers = _numbered(_find_files(path_or_glob))
    gaps = _gaps(paths, numbers, allow_gaps)
    header = read_header(paths[0])
    found = find(preset, header)
    available = found.resolve(header, signal)
    if "radiance" not in available:
        raise InputError(_missing(header, found, signal, "radiance"))
    scene = _read_scene(paths[0].parent / "scene.json", header)
    wanted = {*DEFAULT_LAYERS, *(layers or ())}
    if scene and not {"motion", "motion_next"} <= available.keys():
        wanted |= {"position", "id"}
    rules = {layer: rule for layer, rule in available.items() if layer in wanted}
    for path in paths[1:]:
        _check_like_first(read_header(path), header, rules)
    size = (header.height, header.width)
    return Sequence(paths, numbers, size, signal, found, header, rules, available, gaps, scene)


def _convert(rule: Rule, channels: dict[str, np.ndarray], layer: str) -> Tensor:
    """[1, C, H, W] from [H, W] channels."""
    image = torch.from_numpy(np.stack([sign * channels[n] for n, sign in zip(rule.channels, rule.signs, strict=True)]))
    if layer == "depth":
        image = torch.where(image >= rule.miss, 0.0, image)
    return image[None]


def _find_files(path_or_glob: str | os.PathLike) -> list[Path]:
    """EXR files that are meant, in no order. Hidden files are not: that is what unfinished ones are called."""
    path = Path(path_or_glob)
    if path.is_dir():
        found = [p for p in path.iterdir() if p.suffix.lower() == ".exr" and not p.name.startswith(".")]
        if not found:
            others = sorted(p.name for p in path.iterdir())
            what = f"holds {len(others)} files, e.g. {others[0]}" if others else "is empty"
            raise InputError(f"{path}: no .exr file in this folder: it {what}")
        return found
    if path.is_file():
        return [path]
    if not has_magic(str(path)):
        raise InputError(f"{path}: does not exist; give a folder of EXR files or a glob")
    found = [p for p in map(Path, glob(str(path))) if p.is_file()]
    if not found:
        raise InputError(f"{path}: no file fits this glob")
    return found


def _numbered(files: list[Path]) -> tuple[tuple[Path, ...], tuple[int, ...]]:
    """Files and their frame numbers, sorted by number."""
    runs = {file: re.findall(r"\d+", file.stem) for file in files}
    unnumbered = [file for file in sorted(files) if not runs[file]]
    if unnumbered and len(files) > 1:
        raise InputError(f"{unnumbered[0]}: no frame number in the name; expected digits, as in frame.0001.exr")
    numbers = {file: int(runs[file][-1]) if runs[file] else 0 for file in files}
    ordered = sorted(files, key=lambda file: (numbers[file], file))
    for a, b in itertools.pairwise(ordered):
        if numbers[a] == numbers[b]:
            raise InputError(f"{b}: frame number {numbers[b]} is there twice, {a.name} has it too; "
                             "give a glob that fits one file a frame")  # fmt: skip
    return tuple(ordered), tuple(numbers[file] for file in ordered)


def _gaps(paths: tuple[Path, ...], numbers: tuple[int, ...], allow: bool) -> tuple[int, ...]:
    """The missing frame numbers."""
    steps = list(zip(paths, numbers, numbers[1:], strict=False))
    if not allow and (jumps := [step for step in steps if step[2] - step[1] > 1]):
        path, before, after = jumps[0]
        missing = f"{before + 1}" if after - before == 2 else f"{before + 1} to {after - 1}"
        raise InputError(f"{path}: the next frame is {after}, missing: {missing}; render what is missing, or allow "
                         "gaps (--allow-gaps): history then starts anew after each")  # fmt: skip
    return tuple(n for _, before, after in steps for n in range(before + 1, after))


def _check_like_first(header: ExrHeader, first: ExrHeader, rules: dict[str, Rule]) -> None:
    if (header.width, header.height) != (first.width, first.height):
        raise InputError(f"{header.path}: is {header.width}×{header.height}, expected {first.width}×{first.height} as "
                         f"{first.path.name}; all frames of a sequence must have one size")  # fmt: skip
    for layer, rule in rules.items():
        if missing := [name for name in rule.channels if name not in header.channels]:
            raise InputError(f"{header.path}: lacks {layer} (channel {missing[0]}), which {first.path.name} has; "
                             f"the file has {header.summary}")  # fmt: skip


def _missing(header: ExrHeader, preset: Preset, signal: str, layer: str) -> str:
    label = f"signal '{signal}'" if layer == "radiance" else f"layer '{layer}'"
    others = [s for s in SIGNALS if layer == "radiance" and "radiance" in preset.resolve(header, s)]
    advice = f"choose the signal '{others[0]}', which is there, or " if others else ""
    found = f"no {label} ({preset.name} layout); the file has {header.summary}"
    return f"{header.path}: {found}; {advice}{preset.hint(layer, signal)}"


def _read_scene(path: Path, header: ExrHeader) -> dict | None:
    """Cameras and per-object transforms beside the frames, checked; None where there is no such file."""
    try:
        scene = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON: {error}") from None
    if (found := scene.get("format") if isinstance(scene, dict) else None) != "rtdenoise-scene-1":
        raise InputError(f"{path}: format is {found!r}, expected 'rtdenoise-scene-1'")
    if (scene.get("width"), scene.get("height")) != (header.width, header.height):
        raise InputError(f"{path}: is for {scene.get('width')}×{scene.get('height')} pixels, "
                         f"{header.path.name} has {header.width}×{header.height}")  # fmt: skip
    if not isinstance(scene.get("objects"), dict) or not isinstance(scene.get("frames"), list):
        raise InputError(f"{path}: expected 'objects' (id -> name) and 'frames' (a list)")
    for index, entry in enumerate(scene["frames"]):
        _check_scene_frame(path, index, entry)
    return scene


def _check_scene_frame(path: Path, index: int, entry: dict) -> None:
    label = f"{path}: frames[{index}]"
    if not isinstance(entry, dict) or not isinstance(entry.get("number"), int):
        raise InputError(f"{label}: expected an object with an integer 'number'")
    transforms = entry.get("object_to_world")
    if not isinstance(transforms, dict) or not all(key.isdecimal() for key in transforms):
        raise InputError(f"{label}: expected 'object_to_world' to map object ids to 4×4 matrices")
    arrays = {"world_to_pixel": (4, 4), "camera_origin": (3,)}
    values = [(name, entry.get(name), shape) for name, shape in arrays.items()]
    for name, value, shape in values + [(f"object_to_world[{key}]", m, (4, 4)) for key, m in transforms.items()]:
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"{label}: expected '{name}' as {'×'.join(map(str, shape))} finite numbers")
        # A picture is made by the rows x, y and w; the one for depth plays no part.
        square = array[[0, 1, 3], :3] if name == "world_to_pixel" else array
        if len(shape) == 2 and np.linalg.matrix_rank(square) < len(square):
            raise InputError(f"{label}: '{name}' cannot be inverted; expected a perspective camera and solid objects")
