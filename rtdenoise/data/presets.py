"""How renderers name and scale their channels, and how each is brought to the conventions of `frame.py`.

native   what this project writes: `R,G,B` (or `color.{R,G,B}`, as in a part named color), `indirect.{R,G,B}`,
         `albedo.{R,G,B}`, `normal.{X,Y,Z}`, `depth.Z`, …
cycles   Blender/Cycles 3.x-5.x, multilayer EXR: `<ViewLayer>.<Pass>.<Channel>`. `Vector` holds previous − current in
         X,Y and current − next in Z,W, in pixels with y up. `Diffuse Indirect` is already divided by `Diffuse Color`.
         `Denoising Normal` is in camera space and `Normal` in world space, so `Normal` is preferred.
mitsuba  Mitsuba 3's `aov` integrator: `R,G,B` is the picture of the inner integrator, an AOV `name:type` becomes
         `name.{R,G,B}` (albedo), `name.{X,Y,Z}`, `name.T` (depth) or `name.I` (index). Names that are usual are found.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from rtdenoise.data.exr_format import ExrHeader
from rtdenoise.errors import InputError
from rtdenoise.frame import CHANNELS

SIGNALS = {  # signal -> which of a file's layers become a frame's, where they have another name
    "color": {"radiance": ("color",), "reference_half": ("half_reference",)},
    "indirect": {
        "radiance": ("indirect",),
        "albedo": ("indirect_albedo", "albedo"),
        "reference": ("indirect_reference",),
        "reference_half": ("half_indirect_reference",),
    },
}


@dataclass(frozen=True)
class Rule:
    """One layer from channels: component i is `signs[i]` × the channel `channels[i]`."""

    channels: tuple[str, ...]  # one with a `*` stands for the first channel that fits
    signs: tuple[int, ...]
    miss: float = float("inf")  # depth only: from this distance on, nothing was hit


@dataclass(frozen=True)
class Preset:
    """A renderer's names. `layers` gives alternatives for each layer: the first whose channels are all there counts."""

    name: str
    layers: Mapping[str, tuple[Rule, ...]]
    hints: Mapping[str, str] = field(default_factory=dict, repr=False)  # layer -> what to switch on to have it
    demodulated: frozenset[str] = frozenset()  # signals that the renderer has already divided by the albedo

    def resolve(self, header: ExrHeader, signal: str) -> dict[str, Rule]:
        """The layers of `Frame` that this file has for a signal, each with the rule that makes it."""
        found = {}
        for layer in CHANNELS:
            alternatives = (rule for name in _names(layer, signal) for rule in self.layers.get(name, ()))
            matches = (_match(rule, header.channels) for rule in alternatives)
            if rule := next((match for match in matches if match), None):
                found[layer] = rule
        return found

    def hint(self, layer: str, signal: str) -> str:
        """What to do about a layer of `Frame` that is missing."""
        name = next(name for name in _names(layer, signal) if name in self.layers)
        return self.hints.get(name, f"write it as {', '.join(self.layers[name][0].channels)}")


def _names(layer: str, signal: str) -> tuple[str, ...]:
    return SIGNALS[signal].get(layer, (layer,))


def _match(rule: Rule, channels: Collection[str]) -> Rule | None:
    """The rule with its wildcards filled in; None where a channel is missing."""
    names = []
    for name in rule.channels:
        fitting = [name] if name in channels else [c for c in channels if "*" in name and fnmatchcase(c, name)]
        names += fitting[:1]
    return Rule(tuple(names), rule.signs, rule.miss) if len(names) == len(rule.channels) else None


def _rule(names: str, components: str, signs: tuple[int, ...] = (), miss: float = float("inf")) -> tuple[Rule, ...]:
    """One rule for each of the `|`-separated names: `name.{components}`, or just the components for an empty name."""
    prefixes = [f"{name}." if name else "" for name in names.split("|")]
    return tuple(Rule(tuple(p + c for c in components), signs or (1,) * len(components), miss) for p in prefixes)


NATIVE = Preset(
    "native",
    {
        "color": _rule("|color", "RGB"),
        "indirect": _rule("indirect", "RGB"),
        "albedo": _rule("albedo", "RGB"),
        "normal": _rule("normal", "XYZ"),
        "depth": _rule("depth", "Z"),
        "motion": _rule("motion", "XY"),
        "motion_next": _rule("motion_next", "XY"),
        "position": _rule("position", "XYZ"),
        "id": _rule("id", "I"),
        "reference": _rule("reference", "RGB"),
        "indirect_reference": _rule("indirect_reference", "RGB"),
        "half_reference": _rule("half_reference", "RGB"),
        "half_indirect_reference": _rule("half_indirect_reference", "RGB"),
    },
)

MITSUBA = Preset(
    "mitsuba",
    {
        **NATIVE.layers,
        "albedo": _rule("albedo|alb|aov.albedo", "RGB"),
        "normal": _rule("normal|nn|sh_normal|normals|n|sn|aov.sh_normal|geo_normal|gn", "XYZ"),
        "depth": _rule("*", "T") + _rule("depth", "Z"),
        "position": _rule("position|pos|p|aov.position", "XYZ"),
        "id": _rule("id|shape_index|shape|idx|index|aov.shape_index", "I"),
    },
    hints={
        "indirect": "Mitsuba has no integrator for it: render with `rtdenoise render`, or denoise --signal color",
        "albedo": "add `albedo:albedo` to the aov integrator's `aovs`",
        "normal": "add `normal:sh_normal` to the aov integrator's `aovs`",
        "depth": "add `depth:depth` to the aov integrator's `aovs`",
        "position": "add `position:position` to the aov integrator's `aovs`",
        "id": "add `id:shape_index` to the aov integrator's `aovs`",
        "motion": "Mitsuba has no motion AOV: render with `rtdenoise render`, or add channels motion.X, motion.Y",
        "motion_next": "Mitsuba has no motion AOV: render with `rtdenoise render`, or add motion_next.X, motion_next.Y",
    },
)

_DENOISING_DATA = "switch on View Layer > Passes > Data > Denoising Data"
_VECTOR = "switch on View Layer > Passes > Data > Vector, and motion blur off"
_CYCLES_HINTS = {
    "color": "switch on View Layer > Passes > Data > Combined",
    "indirect": "switch on View Layer > Passes > Light > Diffuse > Indirect",
    "albedo": _DENOISING_DATA,
    "indirect_albedo": "switch on View Layer > Passes > Light > Diffuse > Color",
    "normal": "switch on View Layer > Passes > Data > Normal",
    "depth": "switch on View Layer > Passes > Data > Z",
    "motion": _VECTOR,
    "motion_next": _VECTOR,
    "position": "switch on View Layer > Passes > Data > Position",
    "id": "switch on View Layer > Passes > Data > Indexes > Object Index",
}


def cycles(view_layer: str) -> Preset:
    """The passes of one view layer ("": channels without a view layer in front)."""
    p = f"{view_layer}." if view_layer else ""
    layers = {
        "color": _rule(f"{p}Noisy Image|{p}Combined", "RGB"),
        "indirect": _rule(f"{p}Diffuse Indirect|{p}DiffInd", "RGB"),
        "albedo": _rule(f"{p}Denoising Albedo|{p}Diffuse Color|{p}DiffCol", "RGB"),
        "indirect_albedo": _rule(f"{p}Diffuse Color|{p}DiffCol", "RGB"),  # what Diffuse Indirect was divided by
        "normal": _rule(f"{p}Normal|{p}Denoising Normal", "XYZ"),
        # Cycles stores 1e10 as the depth of what missed.
        "depth": _rule(f"{p}Depth|{p}Denoising Depth", "Z", miss=1e9),
        "motion": _rule(f"{p}Vector", "XY", signs=(1, -1)),
        "motion_next": _rule(f"{p}Vector", "ZW", signs=(-1, 1)),
        "position": _rule(f"{p}Position", "XYZ"),
        "id": _rule(f"{p}Object Index|{p}IndexOB", "X"),
    }
    references = {layer: rule for layer, rule in NATIVE.layers.items() if "reference" in layer}  # added by other tools
    return Preset("cycles", {**references, **layers}, _CYCLES_HINTS, frozenset({"indirect"}))


NAMES = ("native", "cycles", "mitsuba")


def find(name: str, header: ExrHeader) -> Preset:
    """The preset `name` for this file: "auto" detects it, "cycles:NAME" picks one of several view layers.

    Raises `InputError` for a name that is not known, and as `detect` does.
    """
    name, _, view_layer = name.partition(":")
    if name == "auto":
        return detect(header)
    if name == "native":
        return NATIVE
    if name == "mitsuba":
        return MITSUBA
    if name == "cycles":
        return cycles(_choose_view_layer(header, view_layer))
    near = difflib.get_close_matches(name.lower(), NAMES, n=1)
    suggestion = f" (did you mean '{near[0]}'?)" if near else ""
    raise InputError(f"unknown preset '{name}'{suggestion}: known are auto, {', '.join(NAMES)}")


def detect(header: ExrHeader) -> Preset:
    """The preset whose names this file uses.

    Raises `InputError` where there is none, or where a Cycles file has several view layers and no way to choose.
    """
    if view_layers(header):
        return cycles(_choose_view_layer(header, ""))
    found = {
        preset.name: set().union(*(preset.resolve(header, signal) for signal in SIGNALS))
        for preset in (NATIVE, MITSUBA)
    }
    best = max((NATIVE, MITSUBA), key=lambda preset: len(found[preset.name]))  # native where both find as much
    if "radiance" not in found[best.name]:
        raise InputError(f"{header.path}: no known layout (presets: {', '.join(NAMES)}): no R,G,B, no indirect.R,G,B, "
                         f"no <ViewLayer>.Combined.R,G,B among {header.summary}")  # fmt: skip
    return best


def view_layers(header: ExrHeader) -> list[str]:
    """The view layers of a Cycles file, in its order; "Composite", the compositor's result, only if it is alone."""
    pattern = re.compile(r"(?:(.+)\.)?(?:Combined|Noisy Image|Diffuse Indirect|DiffInd)\.R")
    found = dict.fromkeys(match[1] or "" for name in header.channels if (match := pattern.fullmatch(name)))
    return [layer for layer in found if layer != "Composite"] or list(found)


def _choose_view_layer(header: ExrHeader, wanted: str) -> str:
    found = view_layers(header)
    if not found:
        raise InputError(f"{header.path}: no <ViewLayer>.Combined.R as Cycles writes it among {header.summary}")
    if wanted and wanted not in found:
        raise InputError(f"{header.path}: no view layer '{wanted}'; the file has {', '.join(found)}")
    if not wanted and len(found) > 1:
        names = ", ".join(found)
        raise InputError(f"{header.path}: several view layers ({names}): choose one, e.g. preset cycles:{found[0]}")
    return wanted or found[0]
