"""Panoramas are joined at their left and right edges, where a sequence is one. Needs no torch."""

from __future__ import annotations

from dataclasses import replace

from ..data.panorama import find_panorama
from ..data.sequences import Sequence
from .options import CombineOptions, Options

JOINED = "a panorama: its left and right edges are joined; --no-detect-panorama leaves them apart"


def with_panorama(sequence: Sequence, options: Options | CombineOptions) -> tuple[Sequence, list[str]]:
    """The sequence, and its `surfaces`, joined at their edges where the first frame is a panorama, and what to tell of
    it; itself where it is none, or by `options`."""
    H, W = sequence.size
    told = W == 2 * H and sequence.has("depth") and sequence.has("normal")
    if not (options.detect_panorama and told) or sequence.scene:  # a scene tells of cameras with an angle of view
        return sequence, []
    found = find_panorama(sequence.only({"radiance", "depth", "normal"}).read(0))
    surfaces = sequence.surfaces
    if found and surfaces:
        surfaces = replace(surfaces, sequence=replace(surfaces.sequence, beyond=found))
    return replace(sequence, beyond=found, surfaces=surfaces), [JOINED] if found else []
