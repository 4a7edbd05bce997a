"""Frames with motion blur: `--surfaces` takes albedo, normal, depth and motion of a second render without it, and
`--lights` the colours. Needs no torch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data.light import LightPasses, read_light
from ..data.opening import open_sequence
from ..data.sequences import Sequence
from ..data.shutter import GIVEN, Surfaces
from ..errors import InputError
from .options import MIXED, CombineOptions, Options, shutter_times
from .parts import valid


def with_surfaces(sequence: Sequence, options: Options | CombineOptions) -> Sequence:
    """The sequence with the layers of `options.surfaces`; itself without.

    Albedo stays the frame's own where it says what the light was divided by. Raises InputError where the second
    render cannot be opened, has no depth or motion, other frames or another size, or is the first one; and for a
    shutter that there is not.
    """
    times = shutter_times(options)
    if not options.surfaces:
        return sequence
    surfaces = open_sequence(
        options.surfaces, signal=options.signal, preset=options.preset, allow_gaps=options.allow_gaps
    )
    surfaces.require("depth", "motion")
    _check(surfaces, sequence)
    if isinstance(options, Options) and options.signal == "color":
        samples, cycles = surfaces.header.samples, surfaces.layout.name == "cycles"
        surfaces = replace(
            surfaces, virtual_motion=options.virtual_motion and samples < MIXED, fog=options.fog,
            few_samples=0 < samples < MIXED, lost_samples=cycles and samples < MIXED, veiled=cycles and samples < MIXED,
        )  # fmt: skip
    layers = tuple(layer for layer in GIVEN if not (layer == "albedo" and sequence.demodulated))
    return replace(sequence, surfaces=Surfaces(surfaces, *times, layers))


def light_seen(sequence: Sequence, index: int, passes: LightPasses) -> dict[str, np.ndarray]:
    """Colours, emission and environment of a frame with motion blur, from the render without it; none where there is no
    such render. Under motion blur they are noise."""
    if not (surfaces := sequence.surfaces):
        return {}
    sharp, i = surfaces.sequence, surfaces.index(sequence.numbers[index])
    there = sharp.files[i].header().channels.keys()
    clean = {name: rule for name, rule in {**passes.colors, **passes.passed}.items() if there >= {*rule.channels}}
    stored = read_light(sharp, i, LightPasses({}, {}, clean, {}, {}))
    return surfaces.seen(sharp.read(i), {name: valid(image) for name, image in stored.items()})


def _check(surfaces: Sequence, sequence: Sequence) -> None:
    """Raise InputError unless both have the same frames, in other files."""
    if surfaces.size != sequence.size:
        (h, w), (H, W) = surfaces.size, sequence.size
        raise InputError(f"{surfaces.paths[0]}: is {w}×{h}, the frames are {W}×{H}; "
                         "--surfaces is another render of them")  # fmt: skip
    if surfaces.paths[0].resolve() == sequence.paths[0].resolve():
        raise InputError(f"{surfaces.paths[0]}: was named twice; --surfaces is another render, without motion blur")
    if missing := sorted(set(sequence.numbers) - set(surfaces.numbers)):
        raise InputError(f"{surfaces.paths[0].parent}: has no frame {missing[0]}; --surfaces needs one for each frame")
