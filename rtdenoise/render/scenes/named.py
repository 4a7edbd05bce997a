"""Scenes by name, as `rtdenoise render` takes them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...errors import InputError
from ..draw import draw_first
from ..frames import calibrate
from ..stage import Stage
from . import wide
from .caustic import caustic
from .file import open_file
from .pictures import find_pictures, hang
from .sample import sample
from .scene import Scene
from .sunlit import sunlit

MAX_DIGITS = 100  # of a scene's seed


def open_scene(name: str, motion: str | Path | None = None, textures: str | Path | None = None) -> Scene:
    """The scene of a name, with its exposure.

    `sample`, `procedural:SEED` and `wide:SEED` (generators 1 and 2), `sunlit:SEED` (generator 3 with a sun),
    `caustic:SEED`, or a Mitsuba XML file, set in motion by the TOML file `motion`. Some surfaces of a `wide` scene get
    pictures from the folder `textures`. Raises InputError for anything else.
    """
    if textures and not name.startswith("wide:"):
        raise InputError(f"--textures {textures}: goes with wide:SEED, not with '{name}'")
    if name.endswith(".xml"):
        scene = open_file(name, motion)
        return _exposed(scene) if "brightness" in scene.facts else scene
    if motion:
        raise InputError(f"{motion}: a motion file goes with a Mitsuba XML scene, not with '{name}'")
    if name == "sample":
        return sample()
    kind, _, digits = name.partition(":")
    if kind not in ("procedural", "wide", "sunlit", "caustic") or not digits.isdecimal() or len(digits) > MAX_DIGITS:
        raise InputError(f"unknown scene '{name}'; expected sample, procedural:SEED, wide:SEED, sunlit:SEED or "
                         "caustic:SEED with a whole number, or a .xml file")  # fmt: skip
    seed = int(digits)
    if kind == "procedural":
        stage, facts = draw_first(seed)
        return replace(stage.scene, exposure=stage.exposure, facts=facts)
    if kind == "sunlit":
        return _exposed(sunlit(wide.procedural(seed), np.random.default_rng([wide.VERSION, seed, 1])))
    if kind == "caustic":
        return _exposed(caustic(seed))
    scene = wide.procedural(seed, version=2)
    rng = np.random.default_rng([2, seed, 0, 0])
    return _exposed(hang(scene, find_pictures(textures), rng) if textures else scene)


def _exposed(scene: Scene) -> Scene:
    stage = Stage(scene)
    if not np.isfinite(calibrate(stage, scene.facts["brightness"])["noise"]):
        raise InputError(f"{scene.file or scene.name}: nothing lit is seen in frame 0; move the camera's start")
    return replace(scene, exposure=stage.exposure)
