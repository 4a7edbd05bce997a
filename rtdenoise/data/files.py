"""The files of a sequence: one EXR file for each frame, or one for each frame and buffer.

A pattern of file names, relative to the sequence's folder, holds `{frame}` for the digits of the frame number, `{spp}`
for those of a number of samples (the lowest counts), and `*` for anything: `*{frame}_{spp}spp.alb.exr`. A pattern
without `{frame}` names frame 0.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from glob import glob, has_magic
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..wording import counted
from .exr import read_channels, read_header
from .exr_format import ExrHeader
from .numbering import NUMBER, frame_numbers

DESCRIBE = "where each layer has a file, rtdenoise inspect DIR --write my.toml describes them"
COUNTER = r"#+|@+|%\d*d|\$F\d*|\$\{F\d*\}|<F\d*>"  # what other programs write for the number in a name


@dataclass(frozen=True)
class FrameFiles:
    """The files of one frame, read as if they were the parts of one file."""

    number: int
    files: Mapping[str, Path]  # buffer -> file; {"": file} where one file holds everything

    @property
    def path(self) -> Path:
        """The file that stands for the frame in messages."""
        return next(iter(self.files.values()))

    def output_name(self, file: Path) -> str:
        """The name of the output for `file`, the one that holds the signal."""
        return file.name

    def header(self) -> ExrHeader:
        """All channels; those of a buffer have its name in front. Raises `InputError` as `read_header` does, and where
        the files differ in size."""
        headers = {buffer: read_header(path) for buffer, path in self.files.items()}
        first, *others = headers.values()
        for other in others:
            if (other.width, other.height) != (first.width, first.height):
                raise InputError(f"{other.path}: is {other.width}×{other.height}, expected "
                                 f"{first.width}×{first.height} as {first.path.name}")  # fmt: skip
        if "" in headers:
            return first
        channels = {f"{buffer}.{c}": t for buffer, header in headers.items() for c, t in header.channels.items()}
        return ExrHeader(first.path, first.width, first.height, channels, (), 0, first.samples, first.placing)

    def read(self, names: Collection[str], as_stored: bool = False) -> dict[str, np.ndarray]:
        """The pixels `[H, W]` of channels in float32, or in the types of the file, by the names that `header` gives
        them."""
        pixels: dict[str, np.ndarray] = {}
        for path, wanted in self.locate(names).items():
            stored = read_channels(path, list(dict.fromkeys(wanted.values())), as_stored)
            pixels |= {full: stored[name] for full, name in wanted.items()}
        return pixels

    def locate(self, names: Collection[str]) -> dict[Path, dict[str, str]]:
        """Where channels are: file -> name as `header` gives it -> name in that file, which several may share."""
        found: dict[Path, dict[str, str]] = {}
        for full in names:
            buffer, _, name = ("", "", full) if "" in self.files else full.partition(".")
            found.setdefault(self.files[buffer], {})[full] = name
        return found


def find_frames(
    path_or_glob: str | os.PathLike,  # a folder, a glob, or one file
    buffers: Mapping[str, tuple[str, ...]],  # buffer -> patterns, the first that fits any file counts; {}: one file all
    allow_gaps: bool = False,
) -> tuple[FrameFiles, ...]:
    """The frames in order of their numbers: `number_files`, or `{frame}` of the pattern.

    With `buffers`, a glob picks frames by any of their files; the others are found beside. Raises `InputError` where
    there is no file, and for missing or repeated numbers.
    """
    if buffers:
        frames = _buffers(path_or_glob, buffers)
    else:
        frames = tuple(FrameFiles(number, {"": file}) for number, file in number_files(find_files(path_or_glob)))
    check_gaps(frames, allow_gaps)
    return frames


def check_gaps(frames: Sequence[FrameFiles], allow_gaps: bool) -> None:
    """Raise `InputError` for numbers that are missing."""
    for a, b in itertools.pairwise(frames):
        if not allow_gaps and b.number - a.number > 1:
            between = describe_gap((a.number + 1, b.number - 1))
            raise InputError(f"{a.path}: the next frame is {b.number}, missing: {between}; render what is missing, or "
                             "let denoise, combine or inspect allow gaps (--allow-gaps): history then starts anew "
                             "after each")  # fmt: skip


def find_gaps(frames: Sequence[FrameFiles]) -> tuple[tuple[int, int], ...]:
    """(first, last) missing number of each gap."""
    return tuple((a.number + 1, b.number - 1) for a, b in itertools.pairwise(frames) if b.number - a.number > 1)


def describe_gap(gap: tuple[int, int]) -> str:
    """`3`, or `5 to 7`."""
    first, last = gap
    return f"{first}" if first == last else f"{first} to {last}"


def find_files(path_or_glob: str | os.PathLike, suffix: str = ".exr") -> list[Path]:
    """The files of a folder or glob, unordered, without hidden ones: unfinished files have hidden names. Of a glob that
    other files fit, too, those with the suffix."""
    path = Path(path_or_glob)
    if path.is_dir():
        found = [p for p in path.iterdir() if p.suffix.lower() == suffix and not p.name.startswith(".")]
        if not found:
            others = sorted(p.name for p in path.iterdir())
            what = f"holds {counted(len(others), 'file')}, e.g. {others[0]}" if others else "is empty"
            if any(path.glob(f"*/*{suffix}")):
                what = f"has some in folders inside; {DESCRIBE}"
            raise InputError(f"{path}: no {suffix} file in this folder: it {what}")
        return found
    if path.is_file():
        return [path]
    if not has_magic(str(path)):
        star = path.with_name(re.sub(COUNTER, "*", path.name))
        example = "" if star == path else f" in quotes: '{star}'"
        problem = "is no regular file" if path.exists() else "does not exist"
        raise InputError(f"{path}: {problem}; give a folder of {suffix[1:].upper()} files or a glob{example}")
    found = [p for p in map(Path, glob(str(path))) if p.is_file()]
    if not found:
        raise InputError(f"{path}: no file fits this glob")
    return [p for p in found if p.suffix.lower() == suffix] or found


def fits(path_or_glob: str | os.PathLike, buffers: Mapping[str, tuple[str, ...]]) -> bool:
    """Whether the files of two or more buffers exist, and the given file or glob is among them."""
    found = [files for patterns in buffers.values() if (files := _candidates(_folder(path_or_glob), patterns))]
    chosen = _chosen(path_or_glob)
    return len(found) > 1 and (chosen is None or any(path in chosen for files in found for _, _, path in files))


def number_files(files: list[Path]) -> list[tuple[int, Path]]:
    """Files with their frame numbers (`frame_numbers`), ascending. Raises `InputError` for a name without digits, and
    for repeated numbers."""
    found = frame_numbers(file.stem for file in files)
    runs = {file: found[file.stem] for file in files}
    unnumbered = [file for file in sorted(files) if not runs[file]]
    if unnumbered and len(files) > 1:
        raise InputError(f"{unnumbered[0]}: no frame number in the name; expected digits, as in frame.0001.exr")
    numbers = {file: int(run[0]) if run else 0 for file, run in runs.items()}
    ordered = sorted(files, key=lambda file: (numbers[file], file))
    for a, b in itertools.pairwise(ordered):
        if numbers[a] == numbers[b]:
            raise InputError(f"{b}: frame number {numbers[b]} is there twice, {a.name} has it too; "
                             f"give a glob that fits one file a frame; {DESCRIBE}")  # fmt: skip
    return [(numbers[file], file) for file in ordered]


def _buffers(path_or_glob: str | os.PathLike, buffers: Mapping[str, tuple[str, ...]]) -> tuple[FrameFiles, ...]:
    folder, chosen = _folder(path_or_glob), _chosen(path_or_glob)
    frames: dict[int, dict[str, Path]] = {}
    for buffer, patterns in buffers.items():
        candidates = _candidates(folder, patterns)
        if picked := [candidate for candidate in candidates if chosen and candidate[2] in chosen]:
            candidates = picked
        for number, files in itertools.groupby(sorted(candidates), key=lambda candidate: candidate[0]):
            (_, samples, path), *others = files
            if others and others[0][1] == samples:
                raise InputError(f"{others[0][2]}: frame number {number} is there twice, {path.name} has it too; "
                                 "give a glob that fits one of them")  # fmt: skip
            frames.setdefault(number, {})[buffer] = path
    if chosen is not None:
        frames = {number: files for number, files in frames.items() if chosen & set(files.values())}
    if not frames:
        names = ", ".join(patterns[0] for patterns in buffers.values())
        raise InputError(f"{path_or_glob}: no file is named like any of {names}")
    return tuple(FrameFiles(number, frames[number]) for number in sorted(frames))


def _folder(path_or_glob: str | os.PathLike) -> Path:
    path = Path(path_or_glob)
    return path if path.is_dir() else path.parent


def _chosen(path_or_glob: str | os.PathLike) -> set[Path] | None:
    """The files that a glob or file name picks; None for a folder, which stands for all of its files."""
    path = Path(path_or_glob)
    return None if path.is_dir() else {path} if path.is_file() else set(map(Path, glob(str(path))))


def _candidates(folder: Path, patterns: tuple[str, ...]) -> list[tuple[int, int, Path]]:
    """(frame number, samples, file) of the files that match the first pattern that has a match."""
    for pattern in patterns:
        found = []
        for path in folder.glob(re.sub(r"(\{\w+\}|\*)+", "*", pattern)):
            match = re.fullmatch(_expression(pattern), path.relative_to(folder).as_posix())
            if match and not path.name.startswith("."):
                groups = match.groupdict()
                found.append((int(groups.get("frame", 0)), int(groups.get("spp", 0)), path))
        if found:
            return found
    return []


def _expression(pattern: str) -> str:
    escaped = re.escape(pattern).replace(r"\*", ".*?")
    return re.sub(r"\\\{spp\\\}", r"(?P<spp>\\d+)", escaped).replace(r"\{frame\}", f"(?P<frame>{NUMBER})")
