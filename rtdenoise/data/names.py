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
from .files import NUMBER, VERSION, find_files
from .layout import OWN, Layout, Rule

GUESSED = "guessed"
NAMES = {  # layer -> labels in lower case without signs, best first; "": a channel R, or a file, that has none
    "color": "|rgba|rgb|beauty|ci|combined|rgbcolor|color|colour|image|noisy|finalimage|finalcolor|hdr|c",
    "indirect": "indirect|diffuseindirect|indirectdiffuse|globalillumination|gi",
    "albedo": "denoisealbedo|denoisealbedonoisy|denoisingalbedo|albedo|alb|diffusealbedo|diffusefilter|basecolor"
              "|basecolour|diffusecolor|diffcol|visiblediffuse|sourcecolor",
    "normal": "nworld|worldnormal|worldnormals|normalworld|n|normal|normals|nrm|nn|shadingnormal|shadingnormals"
              "|shnormal|avgshadingnormal|normalsshading|visiblenormals|ndenoise|nnoice|denoisenormal|nsmoothed|bumpnormals",
    "depth": "z|depth|zdepth|depthz|linearz|worlddepth|zfiltered|znoice|pz|hitpz|depthextra|cameradepth|distance"
             "|hitdist",
    "motion": "motionback|motionbackward|backward|backwardmotion|previousmotion|motionprevious|motionvector"
              "|motionvectors|motion|motionvec|mvec|mv|velocity|vel|vector|vectors|flow",
    "motion_next": "motionfore|motionforward|forward|forwardmotion|nextmotion|motionnext",
}  # fmt: skip
PROGRAMS = re.compile("^(vray|oct|finalimagemovierenderqueue)")  # in front of a label
COMPONENTS = {  # layer -> endings of its channels, in order; ("",): a channel without any
    **dict.fromkeys(("color", "indirect", "albedo"), ("rgb", "xyz", ("red", "green", "blue"))),
    "normal": ("xyz", "rgb", ("red", "green", "blue")),
    "depth": ("z", "r", "y", "v", "x", "a", ("",), ("red",), ("depth",)),
    **dict.fromkeys(("motion", "motion_next"), ("xy", "uv", "rg", ("red", "green"))),
}
_RANKS = {
    label: (layer, rank) for layer, names in NAMES.items() for rank, label in enumerate(names.split("|"))
}  # fmt: skip


@dataclass(frozen=True)
class _Buffer:
    """Channels that have a label in common."""

    labels: tuple[str, ...]  # the first that is known counts
    channels: dict[str, str]  # ending in lower case -> name in the file

    def rules(self) -> Iterator[tuple[str, int, Rule]]:
        """The layers that this may be: (layer, rank, rule)."""
        layer, rank = next((_RANKS[label] for label in self.labels if label in _RANKS), ("", 0))
        for endings in COMPONENTS.get(layer, ()):
            if all(ending in self.channels for ending in endings):
                yield layer, rank, Rule(tuple(self.channels[ending] for ending in endings), (1,) * len(endings))
                return


def guess(source: str | PathLike) -> Layout:
    """The layout of a folder or glob of EXR files, for the layers in `NAMES` that it seems to hold.

    Where a renderer writes a file for each layer, files of the folders inside a folder count, too. Raises `InputError`
    where nothing is called as a picture is.
    """
    groups = _grouped(source)
    shared = set.intersection(*(set(_words(pattern)) for pattern in groups))
    found: dict[str, tuple[int, Rule, str]] = {}
    for pattern, file in groups.items():
        for buffer in _buffers(read_header(file).channels, _labels(pattern, shared)):
            for layer, rank, rule in buffer.rules():
                if layer not in found or rank < found[layer][0]:
                    found[layer] = rank, rule, pattern
    if "color" not in found:
        header = read_header(next(iter(groups.values())))
        raise InputError(f"{header.path}: no channels that are called as a picture's; the file has {header.summary}: "
                         f"describe it in {OWN}")  # fmt: skip
    layers = {layer: found[layer][1:] for layer in NAMES if layer in found}
    if sum("/" not in pattern for pattern in groups) == 1 and not any("/" in pattern for _, pattern in layers.values()):
        return Layout(GUESSED, {layer: (rule,) for layer, (rule, _) in layers.items()})
    return Layout(
        GUESSED,
        {layer: (rule.of_buffer(layer),) for layer, (rule, _) in layers.items()},
        buffers={layer: (pattern,) for layer, (_, pattern) in layers.items()},
    )


def _grouped(source: str | PathLike) -> dict[str, Path]:
    """Patterns of file names (`files.py`) that as many frames have as any, those of the folder itself first, each with
    its first file."""
    folder = Path(source)
    nested = sorted(file for file in folder.glob("*/*") if file.suffix.lower() == ".exr" and file.name[0] != ".")
    try:
        files = sorted(find_files(source)) + nested
    except InputError:
        if not nested:
            raise
        files = nested
    groups: dict[str, list[Path]] = {}
    for file in files:
        groups.setdefault(_pattern(file.relative_to(folder if nested else file.parent)), []).append(file)
    most = max(map(len, groups.values()))
    return {pattern: files[0] for pattern, files in groups.items() if len(files) == most}


def _pattern(path: PurePath) -> str:
    """The path with `{frame}` for the number that `files.number_files` finds in its name."""
    versions = [match.span() for match in re.finditer(VERSION, path.stem)]
    numbers = [match.span() for match in re.finditer(NUMBER, path.stem)]
    frames = [(a, b) for a, b in numbers if not any(start < b and a < end for start, end in versions)] or numbers
    if not frames:
        return path.as_posix()
    start, end = frames[-1]
    return path.with_name(f"{path.stem[:start]}{{frame}}{path.stem[end:]}{path.suffix}").as_posix()


def _words(pattern: str) -> list[str]:
    return re.findall(r"[a-z0-9]+", pattern.lower().replace("{frame}", " "))


def _labels(pattern: str, shared: set[str]) -> tuple[str, ...]:
    """What the words that not all patterns share say: those of the file's name, then those of its folder."""
    *folder, name = pattern.split("/")
    said = ("".join(word for word in _words(part) if word not in shared) for part in (name, *folder))
    return tuple(filter(None, said)) or ("",)


def _buffers(channels: Iterable[str], labels: tuple[str, ...]) -> list[_Buffer]:
    """The channels of a file whose name has these labels, by their own labels; those without one have the file's."""
    groups: dict[str, dict[str, str]] = {}
    for name in channels:
        label, _, ending = name.rpartition(".")
        if not label and len(name) > 1 and name[-1] in "XYZ":  # 3ds Max's NX, velX
            label, ending = name[:-1], name[-1]
        groups.setdefault(label, {})[ending.lower()] = name
    bare = groups.pop("", {})
    found = [_Buffer(labels, bare), *(_Buffer((_plain(name),), {"": name}) for name in bare.values())]
    return found + [_Buffer((_plain(label), _plain(re.split("[.:]", label)[-1])), c) for label, c in groups.items()]


def _plain(label: str) -> str:
    return PROGRAMS.sub("", re.sub("[^a-z0-9]", "", label.lower()))
