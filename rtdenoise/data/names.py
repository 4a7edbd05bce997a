"""Guess the layout of files that no preset knows, from the names of their channels and of the files themselves.

A *label* is what a name says of a layer: `N` of channel `N.X`, `Z` of channel `Z`, `motionvector` of
`beauty.motionvector.R`, `albedo` of the file `shot_albedo.0012.exr`. `NAMES` lists the labels of each layer, as
renderers' documentation and their users spell them. What motion vectors and depths mean is measured: `run/describe.py`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path, PurePath

from ..errors import InputError
from .exr import read_header
from .exr_format import ExrHeader
from .files import VERSION, find_files, frame_number
from .layers import LAYERS
from .layout import OWN, Layout, Rule, first_match, with_components
from .layouts import MITSUBA, NATIVE, choose, detect, view_layers

GUESSED = "guessed"
NAMES = {  # layer -> labels in lower case without signs, best first; "": a channel R, or a file, that has none
    "color": "|rgba|rgb|beauty|ci|combined|rgbcolor|color|colour|image|noisy|finalimage|finalcolor|hdr|c",
    "indirect": "indirect|diffuseindirect|indirectdiffuse|globalillumination|gi",
    "albedo": "denoisealbedo|denoisealbedonoisy|denoisingalbedo|albedo|alb|diffusealbedo|diffusefilter|basecolor"
              "|basecolour|diffusecolor|diffcol|visiblediffuse|sourcecolor",
    "normal": "nworld|worldnormal|worldnormals|normalworld|n|normal|normals|nrm|nn|shadingnormal|shadingnormals"
              "|shnormal|avgshadingnormal|normalsshading|visiblenormals|ndenoise|nnoice|denoisenormal|nsmoothed"
              "|smoothnormal",
    "depth": "z|depth|zdepth|depthz|linearz|worlddepth|zfiltered|znoice|pz|hitpz|depthextra|cameradepth|distance"
             "|hitdist",
    "motion": "motionback|motionbackward|backward|backwardmotion|previousmotion|motionprevious|motionvector"
              "|motionvectors|motion|motionvec|mvec|mv|velocity|vel|vector|vectors|flow",
    "motion_next": "motionfore|motionforward|forward|forwardmotion|nextmotion|motionnext",
}  # fmt: skip
PROGRAMS = re.compile("^(vray|oct|finalimagemovierenderqueue|finalimage(?=.))")  # in front of a label
PARTS = {  # of a picture or a material, which are no layer of their own
    "specular", "coat", "sheen", "sss", "subsurface", "transmission", "emission", "reflection", "refraction", "crypto",
    "direct", "key", "left", "right",
}  # fmt: skip
COMPONENTS = {  # layer -> endings of its channels, in order; ("",): a channel without any
    **dict.fromkeys(("color", "indirect", "albedo"), ("rgb", ("red", "green", "blue"))),
    "normal": ("xyz", "rgb", ("red", "green", "blue")),
    "depth": ("z", "r", "y", "v", "x", "a", ("",), ("red",), ("depth",)),
    **dict.fromkeys(("motion", "motion_next"), ("xy", "uv", "rg", ("red", "green"))),
}
QUALIFIED = 100  # rank of a label that is only a part of the name, behind those that are all of it
UNKNOWN = 1000  # and of a file without any, which may be the picture
_RANKS = {label: (layer, rank) for layer, names in NAMES.items() for rank, label in enumerate(names.split("|"))}


@dataclass(frozen=True)
class _Group:
    """The files that one pattern (`files.py`) fits."""

    pattern: str
    files: dict[int, Path]  # by frame number

    @property
    def first(self) -> Path:
        """The file of the first frame."""
        return self.files[min(self.files)]


def guess(source: str | PathLike, signal: str = "color") -> Layout:
    """The layout of a folder or glob of EXR files, for the layers in `NAMES` that it seems to hold, and those that a
    preset finds.

    Where a folder holds no EXR files, those of the folders inside count. Raises `InputError` where a preset reads the
    files, and where nothing, or several things, are called as the signal is.
    """
    if known := choose("auto", source):
        raise InputError(f"{source}: --write is for files that no preset knows; these are {known.name}'s")
    groups = _grouped(source)
    headers = [read_header(group.first) for group in groups]
    if len(groups) == 1 and "/" not in groups[0].pattern:
        return _of_channels(headers[0], signal)
    named: dict[str, list[tuple[int, Rule, _Group]]] = {}
    for group, header in zip(groups, headers, strict=True):
        if view_layers(header):
            raise InputError(f"{group.first}: --write is for files that no preset knows; this is one of Cycles: give "
                             "its folder, or a glob of these files")  # fmt: skip
        for layer, (rank, rule) in _named(header.channels, group.pattern).items():
            named.setdefault(layer, []).append((rank, rule, group))
    if signal not in named:
        raise _nothing(headers[0], signal)
    found = {layer: min(named[layer], key=lambda one: one[0])[1:] for layer in NAMES if layer in named}
    least = min(rank for rank, _, _ in named[signal])
    alike = [group.first for rank, _, group in named[signal] if rank == least]
    if len(alike) > 1:
        raise InputError(f"{source}: which is the picture, {' or '.join(map(str, alike))}? Give a glob that fits the "
                         "files of one, or write the preset yourself (docs/use/files.md)")  # fmt: skip
    frames = found[signal][1].files.keys()
    for layer, (_, group) in found.items():
        if not _is_usable(group.pattern):
            raise InputError(f"{source}: cannot describe files called {group.pattern}: a preset needs a frame number "
                             "in the name, and no brackets, braces, * or ?")  # fmt: skip
        if lacking := frames - group.files.keys():
            raise InputError(f"{group.first}: {layer} has no such file of frame {min(lacking)}, which {signal} has: "
                             "give a glob that fits frames with all files")  # fmt: skip
    layers = {layer: (rule.of_buffer(layer),) for layer, (rule, _) in found.items()}
    return Layout(GUESSED, layers, buffers={layer: (group.pattern,) for layer, (_, group) in found.items()})


def guess_channels(channels: Iterable[str]) -> dict[str, Rule]:
    """The layers that these channels of one file seem to be."""
    found = _named(channels)
    return {layer: found[layer][1] for layer in NAMES if layer in found}


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


def _nothing(header: ExrHeader, signal: str) -> InputError:
    what = "a picture's" if signal == "color" else f"{signal} light's"
    return InputError(f"{header.path}: no channels that are called as {what}; the file has {header.summary}: describe "
                      f"it in {OWN}")  # fmt: skip


def _grouped(source: str | PathLike) -> list[_Group]:
    """The files by their patterns, those with most files first."""
    folder = Path(source)
    try:
        files, base = find_files(source), None
    except InputError:
        files, base = [file for file in folder.glob("*/*") if file.suffix.lower() == ".exr"], folder
        files = [file for file in files if not file.name.startswith(".")]
        if not files:
            raise
    groups: dict[str, dict[int, Path]] = {}
    for file in sorted(files):
        pattern, number = _pattern(file.relative_to(base or file.parent))
        groups.setdefault(pattern, {})[number] = file
    found = [_Group(pattern, files) for pattern, files in groups.items()]
    return sorted(found, key=lambda group: -len(group.files))


def _pattern(path: PurePath) -> tuple[str, int]:
    """The path with `{frame}` for its frame number, and that number."""
    run, stem = frame_number(path.stem), path.stem
    if not run:
        return path.as_posix(), 0
    return path.with_name(f"{stem[: run.start()]}{{frame}}{stem[run.end() :]}{path.suffix}").as_posix(), int(run[0])


def _is_usable(pattern: str) -> bool:
    plain = pattern.replace("{frame}", "", 1)
    return plain != pattern and pattern.isprintable() and not set(plain) & set("{}[]*?")


def _named(channels: Iterable[str], pattern: str = "") -> dict[str, tuple[int, Rule]]:
    """The layers that the channels of a file may be, each with its rank and rule. Channels without a label have that of
    the file's name."""
    found: dict[str, tuple[int, Rule]] = {}
    for layer, rank, parts in _labelled(list(channels), pattern):
        rule = _rule(layer, parts)
        if rule and (layer not in found or rank < found[layer][0]):
            found[layer] = rank, rule
    return found


def _labelled(names: list[str], pattern: str) -> Iterator[tuple[str, int, dict[str, str]]]:
    """Layer, rank, and the channels (ending in lower case -> name) of each label that is known."""
    groups: dict[str, dict[str, str]] = {}
    for name in names:
        label, _, ending = name.rpartition(".")
        if not label and name[:-1] and {f"{name[:-1]}X", f"{name[:-1]}Y"} <= {*names}:  # 3ds Max's NX, velX
            label, ending = name[:-1], name[-1]
        groups.setdefault(label, {})[ending.lower()] = name
    bare = groups.pop("", {})
    if found := _of_file(pattern):
        yield *found, bare
    for label, parts in [*((name, {"": name}) for name in bare.values()), *groups.items()]:
        if found := _of_label(label):
            yield *found, parts


def _rule(layer: str, channels: dict[str, str]) -> Rule | None:
    """None where channels of the layer are missing."""
    for endings in COMPONENTS[layer]:
        if all(ending in channels for ending in endings):
            return Rule(tuple(channels[ending] for ending in endings), (1,) * len(endings))
    return None


def _of_label(label: str) -> tuple[str, int] | None:
    """The layer and rank of a channel's label."""
    plain = _plain(label)
    if not plain or plain in _RANKS:
        return _RANKS[plain] if plain else None
    *before, last = re.split("[.:/]", label)
    if before and _plain(before[-1]) not in PARTS and (found := _RANKS.get(_plain(last))):
        return found[0], found[1] + QUALIFIED
    return None


def _of_file(pattern: str) -> tuple[str, int] | None:
    """The layer and rank of a file: of the longest end of its name that is a label, else of its folder."""
    for part in reversed(pattern.split("/")):
        name = re.sub(VERSION, "", PurePath(part.replace("{frame}", " ")).stem if "." in part else part)
        words = re.findall("[A-Za-z0-9]+", name)
        if PARTS & {word.lower() for word in words}:
            return None
        for first in range(len(words)):
            label = _plain("".join(words[first:]))
            if label and (found := _RANKS.get(label)):
                return found
    return "color", UNKNOWN if pattern else 0


def _plain(label: str) -> str:
    return PROGRAMS.sub("", re.sub("[^a-z0-9]", "", label.lower()))
