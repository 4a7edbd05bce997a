"""Guess the layout of files that no preset knows, from the names of their channels and of the files themselves.

`labels.py` says what a name means. What motion vectors and depths mean is measured: `run/describe.py`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from glob import has_magic
from os import PathLike
from pathlib import Path, PurePath

from ..errors import InputError
from .exr import read_header
from .exr_format import ExrHeader
from .files import find_files
from .labels import NAMES, UNKNOWN, FileLabel, layers_of, of_file
from .layers import LAYERS
from .layout import OWN, Layout, Rule, first_match, with_components
from .layouts import MITSUBA, NATIVE
from .numbering import frame_numbers
from .recognise import choose, detect, view_layers

GUESSED = "guessed"
DENOISED = "albedo", "normal", "depth", "motion", "motion_next"  # what a denoiser reads beside the picture
IN_DOUBT, OTHER = 1, 2  # files that may belong to another picture, and that do
IF_MINE = "describe it here if it belongs to the picture"


@dataclass(frozen=True)
class _Group:
    """The files that one pattern (`files.py`) fits."""

    pattern: str
    files: dict[int, Path]  # by frame number

    @property
    def first(self) -> Path:
        """The file of the first frame."""
        return self.files[min(self.files)]

    @cached_property
    def label(self) -> FileLabel:
        """What the name says."""
        return of_file(self.pattern)

    def unlike(self, picture: _Group) -> int:
        """0 where it is called as the picture is; IN_DOUBT, where one name says more, or for another version or
        folder; OTHER for another name."""
        mine, its = self.label, picture.label
        if _apart(mine.words, its.words):
            return OTHER
        more = mine.words != its.words and mine.words and its.words
        return IN_DOUBT if more or _apart(mine.place, its.place) else 0


@dataclass(frozen=True)
class _Found:
    """What may be a layer."""

    rank: int
    rule: Rule
    group: _Group


def guess(source: str | PathLike, signal: str = "color", notes: dict[str, str] | None = None) -> Layout:
    """The layout of a folder or glob of EXR files, for the layers in `NAMES` that it seems to hold, and those that a
    preset finds.

    Where a folder holds no EXR files, those of the folders inside count. Beside files of a glob of one name, others are
    found that are called as its picture is. `notes` takes a line for each layer of which files are in doubt, or left
    out. Raises `InputError` where a preset reads the files, and where nothing, or several things, are called as the
    signal is.
    """
    if known := choose("auto", source):
        raise InputError(f"{source}: --write is for files that no preset knows; these are {known.name}'s")
    notes = {} if notes is None else notes
    groups = _grouped(source)
    groups += _beside(source, groups)
    if len(groups) == 1 and "/" not in groups[0].pattern:
        layout = _of_channels(read_header(groups[0].first), signal)
    else:
        layout = _of_files(source, groups, signal, notes)
    for group in _inside(source, groups):
        if group.label.layer in DENOISED and group.label.layer not in layout.layers:
            notes.setdefault(group.label.layer, f"{group.pattern} is left out: it is in a folder inside; {IF_MINE}")
    return layout


def guess_channels(channels: Iterable[str]) -> dict[str, Rule]:
    """The layers that these channels of one file seem to be."""
    return {layer: rule for layer, (_, rule) in layers_of(channels).items() if layer in NAMES}


def guess_beside(source: str | PathLike) -> set[str]:
    """The layers that files beside those of a glob of one name seem to be, as `guess` finds them."""
    groups = _grouped(source)
    return {group.label.layer for group in _beside(source, groups) if group.unlike(groups[0]) != OTHER}


def _of_channels(header: ExrHeader, signal: str) -> Layout:
    """The layout of files that hold all: what this project's or Mitsuba's names say, and guesses for the rest."""
    layers = {layer: (rule,) for layer, rule in guess_channels(header.channels).items()}
    try:
        preset = detect(header)
    except InputError:
        if view_layers(header):
            raise
        preset = None
    if preset and preset not in (NATIVE, MITSUBA):
        raise InputError(f"{header.path}: --write is for files that no preset knows; these are {preset.name}'s")
    for layer, alternatives in preset.layers.items() if preset else ():
        if layer in LAYERS and (match := first_match(alternatives, header.channels)):
            layers[layer] = (match,)
    if signal not in layers:
        raise _nothing(header, signal)
    return Layout(GUESSED, with_components(layers))


def _of_files(source: str | PathLike, groups: list[_Group], signal: str, notes: dict[str, str]) -> Layout:
    """The layout of files that hold a layer each, or some."""
    headers = [read_header(group.first) for group in groups]
    named: dict[str, list[_Found]] = {}
    for group, header in zip(groups, headers, strict=True):
        if view_layers(header):
            raise InputError(f"{group.first}: --write is for files that no preset knows; this is one of Cycles: give "
                             "its folder, or a glob of these files")  # fmt: skip
        for layer, (rank, rule) in layers_of(header.channels, group.pattern).items():
            named.setdefault(layer, []).append(_Found(rank, rule, group))
    if signal not in named:
        raise _nothing(headers[0], signal)
    least = min(found.rank for found in named[signal])
    alike = [found.group for found in named[signal] if found.rank == least]
    if len(alike) > 1:
        pictures = " or ".join(str(group.first) for group in alike)
        raise InputError(f"{source}: which is the picture, {pictures}? Give a glob that fits the "
                         "files of one, or write the preset yourself (docs/use/files.md)")  # fmt: skip
    picture = alike[0]

    def order(found: _Found) -> tuple[int, ...]:
        return found.group.unlike(picture), len(found.group.label.words ^ picture.label.words), found.rank

    best = {layer: min(named[layer], key=order) for layer in {**NAMES, **LAYERS} if layer in named}
    layers, buffers = {}, {}
    for layer, found in best.items():
        if told := _doubt(found.group, picture):
            notes[layer] = told
        if found.group.unlike(picture) == OTHER:
            continue
        if not _is_usable(found.group.pattern):
            raise InputError(f"{source}: cannot describe files called {found.group.pattern}: a preset needs a frame "
                             "number in the name, and no brackets, braces, * or ?")  # fmt: skip
        if lacking := picture.files.keys() - found.group.files.keys():
            if layer not in (signal, *DENOISED):
                notes[layer] = f"{found.group.pattern} is left out: there is no such file of frame {min(lacking)}"
                continue
            raise InputError(f"{found.group.first}: {layer} has no such file of frame {min(lacking)}, which {signal} "
                             "has: give a glob that fits frames with all files")  # fmt: skip
        layers[layer] = (found.rule.of_buffer(layer),)
        buffers[layer] = (found.group.pattern,)
    return Layout(GUESSED, with_components(layers), buffers=buffers)


def _nothing(header: ExrHeader, signal: str) -> InputError:
    what = "a picture's" if signal == "color" else f"{signal} light's"
    return InputError(f"{header.path}: no channels that are called as {what}; the file has {header.summary}: describe "
                      f"it in {OWN}")  # fmt: skip


def _doubt(group: _Group, picture: _Group) -> str:
    """What there is to say of files that may belong to another picture."""
    unlike = f"{group.pattern} is called otherwise than the picture, {picture.pattern}"
    left_out = f"{unlike}, and left out: {IF_MINE}"
    return {0: "", IN_DOUBT: f"{unlike}: does it belong to it?", OTHER: left_out}[group.unlike(picture)]


def _grouped(source: str | PathLike) -> list[_Group]:
    """The files by their patterns, those with most files first."""
    try:
        return _by_pattern(find_files(source))
    except InputError:
        if found := _by_pattern(Path(source).glob("*/*"), Path(source)):
            return found
        raise


def _beside(source: str | PathLike, groups: list[_Group]) -> list[_Group]:
    """The files of layers that those of a glob lack, in their folder; none for a folder, or a glob of several names."""
    folder, (group, *others) = Path(source).parent, groups
    if Path(source).is_dir() or others or has_magic(str(folder)) or not _is_usable(group.pattern):
        return []
    own = layers_of(read_header(group.first).channels, group.pattern)
    found = [other for other in _by_pattern(folder.glob("*")) if other.label.layer not in ("", *own)]
    return [other for other in found if other.label.rank < UNKNOWN and _is_usable(other.pattern)]


def _inside(source: str | PathLike, groups: list[_Group]) -> list[_Group]:
    """The files in folders inside a folder whose own files count."""
    folder = Path(source)
    return _by_pattern(folder.glob("*/*"), folder) if folder.is_dir() and "/" not in groups[0].pattern else []


def _by_pattern(files: Iterable[Path], base: Path | None = None) -> list[_Group]:
    """EXR files by their patterns beneath `base`, else their folder, those with most files first."""
    groups: dict[str, dict[int, Path]] = {}
    files = [file for file in sorted(files) if file.suffix.lower() == ".exr" and not file.name.startswith(".")]
    runs = frame_numbers(file.stem for file in files)
    for file in files:
        pattern, number = _pattern(file.relative_to(base or file.parent), runs[file.stem])
        groups.setdefault(pattern, {})[number] = file
    found = [_Group(pattern, files) for pattern, files in groups.items()]
    return sorted(found, key=lambda group: -len(group.files))


def _apart(some: frozenset[str], others: frozenset[str]) -> bool:
    """Whether each has a word that the other lacks."""
    return not (some <= others or others <= some)


def _pattern(path: PurePath, run: re.Match | None) -> tuple[str, int]:
    """The path with `{frame}` for its frame number, and that number. `run`: where its stem has it."""
    stem = path.stem
    if not run:
        return path.as_posix(), 0
    return path.with_name(f"{stem[: run.start()]}{{frame}}{stem[run.end() :]}{path.suffix}").as_posix(), int(run[0])


def _is_usable(pattern: str) -> bool:
    plain = pattern.replace("{frame}", "", 1)
    return plain != pattern and pattern.isprintable() and not set(plain) & set("{}[]*?")
