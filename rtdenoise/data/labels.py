"""What names say of layers: labels, of channels and of files.

A *label* is what a name says of a layer: `N` of channel `N.X`, `Z` of channel `Z`, `motionvector` of
`beauty.motionvector.R`, `albedo` of the files `shot_albedo.0012.exr` and `ShotAlbedo0012.exr`. `NAMES` lists the labels
of each layer, as renderers' documentation and their users spell them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import PurePath

from .layers import LAYERS
from .layout import Rule, first_match
from .layouts import NATIVE
from .numbering import SAMPLES, VERSION

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
    "reference": "reference|ref",
    "reference_half": "referencehalf",
    "indirect_reference": "indirectreference",
    "indirect_reference_half": "indirectreferencehalf",
    "position": "position",
}  # fmt: skip
PROGRAMS = re.compile("^(vray|oct|finalimagemovierenderqueue|finalimage(?=.))")  # in front of a label
PARTS = {  # of a picture or a material, which are no layer of their own
    "specular", "coat", "sheen", "sss", "subsurface", "transmission", "emission", "reflection", "refraction", "crypto",
    "direct", "key", "left", "right",
}  # fmt: skip
COLOURS = (
    "color", "indirect", "albedo", "reference", "reference_half", "indirect_reference", "indirect_reference_half",
)  # fmt: skip
COMPONENTS = {  # layer -> endings of its channels, in order; ("",): a channel without any
    **dict.fromkeys(COLOURS, ("rgb", ("red", "green", "blue"))),
    **dict.fromkeys(("normal", "position"), ("xyz", "rgb", ("red", "green", "blue"))),
    "depth": ("z", "r", "y", "v", "x", "a", ("",), ("red",), ("depth",)),
    **dict.fromkeys(("motion", "motion_next"), ("xy", "uv", "rg", ("red", "green"))),
}
QUALIFIED = 100  # rank of a label that is only a part of the name, behind those that are all of it
UNKNOWN = 1000  # and of a file without any, which may be the picture
WORD = re.compile("[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")  # of a name: Shot, 01 and Beauty of Shot01Beauty
SHORT = 2  # letters: labels that are no longer stand behind a separator
_RANKS = {label: (layer, rank) for layer, names in NAMES.items() for rank, label in enumerate(names.split("|"))}


@dataclass(frozen=True)
class FileLabel:
    """What the name of a file, and of its folder, says."""

    layer: str  # "" for a part of a picture, or of a material
    rank: int = UNKNOWN
    words: frozenset[str] = frozenset()  # of the file's name besides labels
    place: frozenset[str] = frozenset()  # versions, and words of its folder


def layers_of(channels: Iterable[str], pattern: str = "") -> dict[str, tuple[int, Rule]]:
    """The layers that the channels of a file may be, each with its rank and rule. Channels without a label have that of
    the file's name, which `pattern` (`files.py`) fits. Layers without labels are those of the native layout."""
    names, others = list(channels), [layer for layer in LAYERS if layer not in NAMES]
    found = {layer: (0, rule) for layer in others if (rule := first_match(NATIVE.layers[layer], names))}
    for layer, rank, parts in _labelled(names, pattern):
        rule = _rule(layer, parts)
        if rule and (layer not in found or rank < found[layer][0]):
            found[layer] = rank, rule
    return found


def of_file(pattern: str) -> FileLabel:
    """What a pattern says: the layer of the longest end of its name that is a label, else of its folder, else the
    picture."""
    if not pattern:
        return FileLabel("color", 0)
    *folders, name = pattern.split("/")
    stem = PurePath(name.replace("{frame}", " ")).stem
    versions = {match[0].lower() for match in re.finditer(VERSION, stem)}
    found = [_at_end(re.sub(f"{VERSION}|{SAMPLES}", " ", part)) for part in (stem, *reversed(folders))]
    layer, rank = next((label for label, _ in found if label), ("color", UNKNOWN))
    (_, words), *others = found
    return FileLabel(layer, rank, words, frozenset(versions.union(*(place for _, place in others))))


def _at_end(name: str) -> tuple[tuple[str, int] | None, frozenset[str]]:
    """Layer and rank of the longest end of a name that is a label, "" for a part of a picture, None for neither; and
    the other words, in lower case."""
    words, found = list(WORD.finditer(name)), None
    plain = [word[0].lower() for word in words]
    for i, word in enumerate(words):
        label, stands_apart = _plain("".join(plain[i:])), not name[: word.start()][-1:].isalnum()
        if label in _RANKS and (len(label) > SHORT or (label and stands_apart)):
            found = ("", UNKNOWN) if i and plain[i - 1] in PARTS else _RANKS[label]
            plain = plain[:i]
            break
    if PARTS & {word.lower() for word in re.findall("[A-Za-z0-9]+", name)}:
        found = "", UNKNOWN
    return found, frozenset(word for word in plain if len(word) <= SHORT or word not in _RANKS)


def _labelled(names: list[str], pattern: str) -> Iterator[tuple[str, int, dict[str, str]]]:
    """Layer, rank, and the channels (ending in lower case -> name) of each label that is known."""
    groups: dict[str, dict[str, str]] = {}
    for name in names:
        label, _, ending = name.rpartition(".")
        if not label and name[:-1] and {f"{name[:-1]}X", f"{name[:-1]}Y"} <= {*names}:  # 3ds Max's NX, velX
            label, ending = name[:-1], name[-1]
        groups.setdefault(label, {})[ending.lower()] = name
    bare = groups.pop("", {})
    if (file := of_file(pattern)).layer:
        yield file.layer, file.rank, bare
    vector = {"x", "y"} <= bare.keys()  # whose Z is no depth
    single = [(name, {"": name}) for ending, name in bare.items() if not (vector and ending == "z")]
    for label, parts in [*single, *groups.items()]:
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


def _plain(label: str) -> str:
    return PROGRAMS.sub("", re.sub("[^a-z0-9]", "", label.lower()))
