"""A folder or glob of files as a sequence: headers are checked up front."""

from __future__ import annotations

import os
from collections.abc import Collection
from pathlib import Path

from ..errors import InputError
from .exr_format import ExrHeader
from .files import FrameFiles, find_frames, find_gaps
from .layers import SIGNALS
from .layout import Layout, Rule
from .noisebase import NOISEBASE, find_archives
from .recognise import choose, find, samples, settled
from .scene_file import read_scene
from .sequences import DEFAULT_LAYERS, Sequence, layer_names, no_layer


def open_sequence(
    path_or_glob: str | os.PathLike,  # a folder, a glob, or one file
    *,
    signal: str = "color",  # "color" or "indirect"
    # a name of `layouts.NAMES`, "cycles:<ViewLayer>", "noisebase:<samples>", or a .toml file
    preset: str | os.PathLike | Layout = "auto",
    # layers of `Frame` to read beside DEFAULT_LAYERS, where the files have them: several names, or one
    layers: Collection[str] | str | None = None,
    allow_gaps: bool = False,  # accept missing frame numbers; `Sequence.gaps` lists them
) -> Sequence:
    """The EXR files of a folder, a glob or one name as a `Sequence` of `Frame`s: `[1, C, H, W]` float32 tensors.

    `signal` chooses the light in `radiance`: 'color', the beauty, or 'indirect' light. `preset` is the files' layout;
    'auto' finds it. All headers are checked at once: one size, one set of layers, complete files, consecutive numbers.
    The frame number is the last run of digits in a file's name that is no version (`_v02`), no number of samples
    (`_64spp`) and no part of a word that all share (`_4k`), or where a layout's pattern has it. Missing numbers are an
    error unless `allow_gaps`. Raises InputError, in one line, for whatever does not fit.
    """
    if signal not in SIGNALS:
        raise InputError(f"unknown signal '{signal}': known are {', '.join(SIGNALS)}")
    layers = layer_names(layers or ())
    preset = os.fspath(preset) if isinstance(preset, os.PathLike) else preset
    chosen = choose(preset, path_or_glob)
    if chosen is NOISEBASE:
        files = find_archives(path_or_glob, samples(preset), allow_gaps)
    else:
        files = find_frames(path_or_glob, chosen.buffers if chosen else {}, allow_gaps)
    header = files[0].header()
    found = settled(chosen, header) if chosen else find(preset, header)
    available = found.resolve(header, signal)
    if "radiance" not in available:
        raise InputError(no_layer(header, found, signal, "radiance"))
    path = files[0].path.parent / found.cameras
    scene = read_scene(path, header)
    wanted = {*DEFAULT_LAYERS, *layers}
    if scene and not {"depth", "motion", "motion_next"} <= available.keys():
        wanted |= {"position", "id"}
        if "position" in available:
            _check_entries(files, scene, path)
    rules = {layer: rule for layer, rule in available.items() if layer in wanted}
    for frame_files in files[1:]:
        _check_like_first(frame_files.header(), header, rules)
    size, gaps = (header.height, header.width), find_gaps(files)
    return Sequence(files, size, signal, found, header, rules, available, gaps, scene)


def _check_like_first(header: ExrHeader, first: ExrHeader, rules: dict[str, Rule]) -> None:
    if (header.width, header.height) != (first.width, first.height):
        raise InputError(f"{header.path}: is {header.width}×{header.height}, expected {first.width}×{first.height} as "
                         f"{first.path.name}; all frames of a sequence must have one size")  # fmt: skip
    windows = [h.placing["dataWindow"] for h in (header, first) if h.placing]
    if len(set(windows)) > 1:
        (x, y), (left, top) = (window[0] for window in windows)
        raise InputError(f"{header.path}: its data window begins at ({x}, {y}), that of {first.path.name} at "
                         f"({left}, {top}); render all frames with one, as motion counts from its corner")  # fmt: skip
    for layer, rule in rules.items():
        if missing := [name for name in rule.channels if name not in header.channels]:
            raise InputError(f"{header.path}: lacks {layer} (channel {missing[0]}), which {first.path.name} has; "
                             f"the file has {header.summary}")  # fmt: skip


def _check_entries(files: tuple[FrameFiles, ...], scene: dict, path: Path) -> None:
    """Raise InputError unless the scene, from which motion is computed, describes every frame."""
    numbers = {entry["number"] for entry in scene["frames"]}
    for frame in files:
        if frame.number not in numbers:
            raise InputError(f"{path}: no entry for frame {frame.number}, which {frame.path.name} is; render the scene "
                             "file anew, or write the layers depth, motion and motion_next")  # fmt: skip
