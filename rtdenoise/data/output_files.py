"""The files and channels that a run writes, known before anything is denoised: their names, whether they can be
written, and that none of the files is one of the input's."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from ..errors import InputError
from .layout import Rule
from .sequences import Sequence

LAYOUTS = ("plain", "source")
ALPHAS = ("auto", "rendered")


def check_output(
    sequence: Sequence,
    layout: str,
    recombine: bool,
    keep: tuple[str, ...],
    alpha: str = "auto",
    confidence: bool = False,  # whether that is written, too
) -> None:
    """Raise `InputError` for output that cannot be written, before anything is denoised."""
    for what, given, known in (("layout", layout, LAYOUTS), ("alpha", alpha, ALPHAS)):
        if given not in known:
            raise InputError(f"unknown {what} '{given}': known are {', '.join(known)}")
    if layout == "source" and sequence.paths[0].suffix.lower() != ".exr":
        raise InputError(f"{sequence.paths[0]}: layout 'source' copies EXR files, this is none: choose 'plain'")
    if layout == "source" and keep:
        raise InputError("layout 'source' passes every channel on: leave --keep out")
    sequence.require_channels(kept_channels(sequence, keep), "--keep")
    if recombine and sequence.signal != "color":
        beauty = sequence.layout.resolve(sequence.header, "color").get("radiance")
        if beauty is None:
            raise InputError(f"{sequence.paths[0]}: --recombine needs the beauty, the file has "
                             f"{sequence.header.summary}; {sequence.layout.hint('radiance', 'color')}")  # fmt: skip
        sequence.require_channels(beauty.channels, "--recombine")
    if recombine and sequence.demodulated and "albedo" not in sequence.rules:
        raise InputError(f"{sequence.paths[0]}: --recombine needs the albedo that the signal was divided by; "
                         f"{sequence.layout.hint('albedo', sequence.signal)}")  # fmt: skip
    sources: dict[str, Path] = {}
    for name, file in _written(sequence, layout, recombine):
        if name in sources:
            raise InputError(f"{file}: would be written to the same file as {sources[name]}: {name}; rename the files, "
                             "so that each has a name of its own")  # fmt: skip
        sources[name] = file
    if confidence and layout != "plain":
        raise InputError("--confidence: goes with --layout plain; layout 'source' has the channels of the input only")


def protect_input(sequence: Sequence, out: Path, layout: str, recombine: bool) -> None:
    """Raise `InputError` where the output folder holds the input, or one of the output files is an input file: links
    are followed."""
    inputs = [path for frame in sequence.files for path in frame.files.values()]
    folders = {folder for path in inputs for folder in (path.parent.resolve(), path.resolve().parent)}
    if out.resolve() in folders or _identity(out) in {_identity(folder) for folder in folders}:
        raise InputError(f"{out}: this folder holds the input, which is never written to; choose another --out")
    identities = {_identity(path) for path in inputs}
    for name, _ in _written(sequence, layout, recombine):
        if (found := _identity(out / name)) and found in identities:
            raise InputError(f"{out / name}: is a file of the input, which is never written to; choose another --out")


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and number of a file or folder, links followed; None where there is none."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def output_names(sequence: Sequence, layout: str, recombine: bool) -> list[list[str]]:
    """The names of the files that a run writes for each frame."""
    return [[name for name, _ in frame] for frame in _files(sequence, layout, recombine)]


def _written(sequence: Sequence, layout: str, recombine: bool) -> Iterator[tuple[str, Path]]:
    """(name in the output folder, the input file that it is made from) of every file that a run writes."""
    return chain.from_iterable(_files(sequence, layout, recombine))


def _files(sequence: Sequence, layout: str, recombine: bool) -> Iterator[list[tuple[str, Path]]]:
    """`_written`, a list a frame."""
    if layout == "plain":
        yield from ([pair] for pair in zip(sequence.names, sequence.paths, strict=True))
        return
    beauty = sequence.layout.beauty_rule(sequence.header) if recombine else None
    channels = {*place_of(sequence).channels, *(beauty.channels if beauty else ())}
    for files, path in zip(sequence.files, sequence.paths, strict=True):
        yield [(name_of(file, path), file) for file in files.locate(channels)]


def place_of(sequence: Sequence) -> Rule:
    """The channels of the input that the denoised signal replaces."""
    beauty = sequence.layout.beauty_rule(sequence.header) if sequence.signal == "color" else None
    return beauty or sequence.rules["radiance"]


def name_of(file: Path, signal: Path) -> str:
    """The name of the output for `file`: its own, with its folder in front where the signal's file has the same."""
    return f"{file.parent.name}.{file.name}" if file != signal and file.name == signal.name else file.name


def kept_channels(sequence: Sequence, keep: tuple[str, ...]) -> list[str]:
    """The channels that are passed on, without `R,G,B`, where the result stands.

    Each of `keep` is a layer or channel as the file calls it, with or without the view layer, a layer of `Frame` that
    the file has under whatever name, or 'all'. Raises InputError for what is none of these.
    """
    kept, channels = set(), sequence.header.channels
    layers = {channel: channel.rpartition(".")[0] for channel in channels}
    for name in keep:
        rule = sequence.available.get(name)
        found = {c for c, layer in layers.items() if name in ("all", c, layer, layer.rpartition(".")[2])}
        found = found or set(rule.channels if rule else ())
        if not found:
            raise InputError(f"{sequence.paths[0]}: no '{name}' to keep; the file has {sequence.header.summary}")
        kept |= found
    return [channel for channel in channels if channel in kept - {"R", "G", "B"}]
