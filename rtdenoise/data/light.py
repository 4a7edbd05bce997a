"""The light of a renderer's frame in parts: the passes that add up to its picture, and further layers by name.

Cycles splits its picture: Combined is Σ (Direct + Indirect) · Color over diffuse, glossy and transmission, plus
volumes, Emission and Environment, the latter but for a transparent film. Light groups are additive too:
`Combined_key + Combined_fill + … = Combined`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError, did_you_mean
from .layout import Rule, rules
from .sequences import Sequence, convert

LOBES = {"Diffuse": "Diff", "Glossy": "Gloss", "Transmission": "Trans"}  # Blender 5 -> 3 and 4
KINDS = {"Direct": "Dir", "Indirect": "Ind", "Color": "Col"}
OTHERS = {"Emission": "Emit", "Environment": "Env"}
VOLUMES = {"Volume Direct": "VolumeDir", "Volume Indirect": "VolumeInd"}  # only scenes with volumes need them
WHERE = "switch on View Layer > Passes > Light"


@dataclass(frozen=True)
class LightPasses:
    """The channels of a file's light. A light belongs to the colour of its lobe; those in `also` are whole radiance."""

    lights: Mapping[str, Rule]  # divided by the lobe's colour already: "Diffuse Direct" …
    volumes: Mapping[str, Rule]  # have no colour
    colors: Mapping[str, Rule]  # lobe -> its colour
    passed: Mapping[str, Rule]  # without noise: emission and environment
    also: Mapping[str, Rule] = field(default_factory=dict)  # name -> layer to denoise beside them
    alpha: Mapping[str, Rule] = field(default_factory=dict)  # SHADOWS -> the picture's alpha, where it holds any

    @property
    def summands(self) -> list[str]:
        """The passes that add up to the picture, once each light is multiplied by its colour."""
        return [*self.lights, *self.volumes, *self.passed]

    def radiance(self, stored: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The lights times the colour of their lobe, of all passes by name."""
        return {name: stored[name] * stored[name.split()[0]] for name in self.lights}

    @property
    def rules(self) -> dict[str, Rule]:
        """All passes."""
        return {**self.lights, **self.volumes, **self.colors, **self.passed, **self.also, **self.alpha}


def find_light(sequence: Sequence, lights: bool, also: tuple[str, ...]) -> LightPasses:
    """The light passes of a Cycles sequence (with `lights`), and the layers `also`.

    Raises InputError where a pass is missing, or a name in `also` fits no layer of colours.
    """
    if any("" not in frame.files for frame in sequence.files):
        raise InputError(f"{sequence.paths[0]}: --lights and --also take files that hold all layers of a frame")
    beauty = sequence.layout.beauty_rule(sequence.header)
    prefix = beauty.channels[0].removesuffix("R").removesuffix("Combined.") if beauty else ""
    found = {}
    if lights:
        if sequence.layout.name != "cycles":
            raise InputError(f"{sequence.paths[0]}: --lights reads the light passes of Blender's Cycles, this file "
                             f"is {sequence.layout.name}: leave --lights out, or name layers by --also")
        found = _light_passes(sequence, prefix)
        if taken := [name for name in also if name in found or f"{name} Color" in found]:
            raise InputError(f"--also {taken[0]}: --lights denoises this pass already: leave it out, or rename it")
    layers = {name: _layer(sequence, prefix, name) for name in also}
    if beauty and (whole := [name for name, rule in layers.items() if rule.channels == beauty.channels]):
        raise InputError(f"--also {whole[0]}: is the picture itself, which is denoised anyway: leave it out")
    return LightPasses(
        lights={k: v for k, v in found.items() if k.endswith("irect") and k not in VOLUMES},  # Direct, Indirect
        volumes={k: v for k, v in found.items() if k in VOLUMES},
        colors={k.removesuffix(" Color"): v for k, v in found.items() if k.endswith(" Color")},
        passed={k: v for k, v in found.items() if k in OTHERS},
        also=layers,
    )


def read_light(sequence: Sequence, index: int, passes: LightPasses) -> dict[str, np.ndarray]:
    """Every pass of a frame, `[1, 3, H, W]` float32, as stored."""
    pixels = sequence.planes(index, {name for rule in passes.rules.values() for name in rule.channels})
    return {name: convert(rule, pixels, "radiance") for name, rule in passes.rules.items()}


def _light_passes(sequence: Sequence, prefix: str) -> dict[str, Rule]:
    short = {f"{lobe} {kind}": f"{a}{b}" for lobe, a in LOBES.items() for kind, b in KINDS.items()}
    found, missing = {}, []
    for name, old in {**short, **OTHERS, **VOLUMES}.items():
        matches = (rule.match(sequence.header.channels) for rule in rules(f"{prefix}{name}|{prefix}{old}", "RGB"))
        if rule := next((match for match in matches if match), None):
            found[name] = rule
        elif name not in VOLUMES:
            missing.append(name)
    if missing:
        raise InputError(f"{sequence.paths[0]}: --lights needs all light passes, missing: {', '.join(missing)}; "
                         f"{WHERE} and render again, or leave --lights out")  # fmt: skip
    return found


def _layer(sequence: Sequence, prefix: str, name: str) -> Rule:
    channels = sequence.header.channels
    literal = name and not set(name) & set("*?[|")  # which `rules` takes for patterns
    for full in (f"{prefix}{name}", name) if literal else ():
        if rule := rules(full, "RGB")[0].match(channels):
            return rule
        if rules(full, "XYZ")[0].match(channels):
            raise InputError(f"{sequence.paths[0]}: --also {name}: holds vectors (X, Y, Z) and no light: leave it out; "
                             "--layout source passes it on")  # fmt: skip
    layers = {c.rpartition(".")[0] for c in channels}
    known = {layer.removeprefix(prefix) for layer in layers if all(f"{layer}.{c}" in channels for c in "RGB")}
    raise InputError(f"{sequence.paths[0]}: --also: no layer {name!r} of three colours{did_you_mean(name, known)}; "
                     f"the file has {', '.join(sorted(known))}")  # fmt: skip
