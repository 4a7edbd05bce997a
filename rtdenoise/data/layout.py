"""A file layout: rules that turn named channels into the layers of a frame, and patterns of file names."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase

from ..frame import CHANNELS
from .components import NOTHING_TO_SPLIT
from .exr_format import ExrHeader
from .layers import COMPONENTS, SIGNALS

SCALES = {  # of motion -> times the picture's width and height, as it is written for x and y
    "uv": (1.0, "W·", "H·"), "ndc": (0.5, "W/2·", "H/2·"), "2uv": (2.0, "2W·", "2H·"),
}  # fmt: skip
OWN = "a layout of your own (--preset my.toml)"


@dataclass(frozen=True)
class Rule:
    """How channels make a layer: component i is `signs[i]` · `scale` · (the channel `channels[i]` − `offset`)."""

    channels: tuple[str, ...]  # a name with a `*` stands for the first channel that matches
    signs: tuple[int, ...]
    miss: float = float("inf")  # depth only: nothing was hit from this distance on, whatever its sign
    scale: float | str = 1.0  # motion only: pixels of a unit, or one of SCALES; normals: a number
    offset: float = 0.0  # motion and normals only: what stands for 0

    def match(self, channels: Collection[str]) -> Rule | None:
        """The rule with its wildcards filled in; None where a channel is missing."""
        names = []
        for name in self.channels:
            fitting = [name] if name in channels else [c for c in channels if "*" in name and fnmatchcase(c, name)]
            names += fitting[:1]
        return replace(self, channels=tuple(names)) if len(names) == len(self.channels) else None

    @property
    def formulas(self) -> tuple[str, ...]:
        """Each component as it is computed: `-W·velocity.X`, `2·(N.X - 0.5)`."""
        known = isinstance(self.scale, str)
        units = SCALES[self.scale][1:] if known else ("" if self.scale == 1 else f"{self.scale:g}·",) * 3
        names = [f"({c} - {self.offset:g})" for c in self.channels] if self.offset else self.channels
        return tuple(
            ("-" if sign < 0 else "") + unit + name
            for name, sign, unit in zip(names, self.signs, units, strict=False)
        )

    def of_buffer(self, buffer: str) -> Rule:
        """The rule for a file of its own."""
        return replace(self, channels=tuple(f"{buffer}.{name}" for name in self.channels))


def first_match(alternatives: Iterable[Rule], channels: Collection[str]) -> Rule | None:
    """The first of the rules whose channels are all there."""
    return next((match for match in (rule.match(channels) for rule in alternatives) if match), None)


def pixels(scale: float | str, size: tuple[int, int]) -> tuple[float, float]:
    """How many pixels a unit of motion is along x and y, in a picture of `size` (H, W)."""
    if scale not in SCALES:
        return scale, scale
    share, (H, W) = SCALES[scale][0], size
    return share * W, share * H


def rules(names: str, components: str, signs: tuple[int, ...] = (), **conversion) -> tuple[Rule, ...]:
    """One rule for each of the `|`-separated names: `name.{components}`, or just the components for an empty name."""
    prefixes = [f"{name}." if name else "" for name in names.split("|")]
    signs = signs or (1,) * len(components)
    return tuple(Rule(tuple(prefix + c for c in components), signs, **conversion) for prefix in prefixes)


def with_components(layers: Mapping[str, tuple[Rule, ...]]) -> dict[str, tuple[Rule, ...]]:
    """`layers` of one rule each, and `components` where all their parts are there."""
    if not all(name in layers for name in COMPONENTS):
        return dict(layers)
    parts = [layers[name][0] for name in COMPONENTS]
    channels, signs = (tuple(x for part in parts for x in getattr(part, key)) for key in ("channels", "signs"))
    return {**layers, "components": (Rule(channels, signs),)}


@dataclass(frozen=True)
class Layout:
    """The channel and file names of a renderer.

    `layers` gives alternatives for each layer on disk: the first whose channels are all present counts. Where a
    renderer writes one file for each buffer, `buffers` names the files; the channels of such a file carry the buffer's
    name, as in a part of a multi-part file: `albedo.R`.
    """

    name: str
    layers: Mapping[str, tuple[Rule, ...]]
    hints: Mapping[str, str] = field(default_factory=dict, repr=False)  # layer -> how to make the renderer write it
    demodulated: frozenset[str] = frozenset()  # signals that the renderer has already divided by the albedo
    buffers: Mapping[str, tuple[str, ...]] = field(default_factory=dict, repr=False)  # buffer -> patterns, see files.py
    cameras: str = "scene.json"  # the file beside the frames that may hold cameras and transforms
    beauty: tuple[Rule, ...] = ()  # where the finished picture belongs; empty: where `color` is read from
    path: Rule | None = None  # length of the path to what is seen in mirrors and through glass (`virtual_motion`)
    more_history: bool = False  # that of `Frame`
    fog: Mapping[str, tuple[Rule, ...]] = field(default_factory=dict)  # light of volumes and of the "sky" (`with_fog`)
    like: str = ""  # a preset, whose layers count where this has none (`recognise.settled`)

    def resolve(self, header: ExrHeader, signal: str) -> dict[str, Rule]:
        """The layers of `Frame` that this file has for a signal, each with the rule that makes it."""
        found = {}
        for layer in CHANNELS:
            alternatives = (rule for name in _names(layer, signal) for rule in self.layers.get(name, ()))
            if rule := first_match(alternatives, header.channels):
                found[layer] = rule
        return found

    def beauty_rule(self, header: ExrHeader) -> Rule | None:
        """The channels of the finished picture; None where the file has none."""
        return first_match(self.beauty or self.layers.get("color", ()), header.channels)

    def alpha(self, header: ExrHeader) -> str:
        """The channel of the finished picture's alpha; "" where the file has none."""
        beauty = self.beauty_rule(header)
        name = beauty.channels[0].removesuffix("R") + "A" if beauty else ""
        return name if name in header.channels else ""

    def hint(self, layer: str, signal: str) -> str:
        """How to get a layer of `Frame` that is missing."""
        if layer == "components":
            return NOTHING_TO_SPLIT[signal]
        names = _names(layer, signal)
        for name in names:
            if name in self.hints:
                return self.hints[name]
            if name in self.layers:
                channels = self.layers[name][0].channels
                buffer = channels[0].partition(".")[0]
                name = ", ".join(channels)
                if buffer in self.buffers:
                    name = f"{', '.join(c.removeprefix(f'{buffer}.') for c in channels)} in {self.buffers[buffer][0]}"
                return f"write it as {name}, or name it in {OWN}"
        return f"this layout has no name for {names[-1]}: describe the files in {OWN}"


def _names(layer: str, signal: str) -> tuple[str, ...]:
    """The layers on disk that may become a layer of `Frame`, best first."""
    if layer == "albedo":  # best: the albedo that the renderer has divided the signal by
        return f"{signal}_albedo", "albedo"
    if layer == "components" and signal != "color":  # they make up the beauty
        return ("indirect components",)
    return (SIGNALS[signal].get(layer, layer),)
