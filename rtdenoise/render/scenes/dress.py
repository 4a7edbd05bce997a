"""Simple objects that cross the view of a scene file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..frames import features
from ..stage import Stage
from . import textures
from .extras import SHAPES, free_place
from .motions import Motion, rigid
from .procedural import log_uniform
from .scene import Material, Object, Scene


def dress(scene: Scene, rng: np.random.Generator, frames: int) -> Scene:
    """The scene with one to three objects more that pass the view in the middle of a clip of `frames`."""
    stage, start = Stage(scene), (frames - 1) / 2
    camera = scene.camera(start)
    right, forward, origin = (camera.to_world[:3, k] for k in (0, 2, 3))
    depth = features(stage, round(start), (48, 48))["depth"]
    unit = float(np.median(depth[depth > 0])) * np.tan(np.radians(camera.fov / 2)) if (depth > 0).any() else 1.0
    extras = []
    for _ in range(int(rng.integers(1, 4))):
        shape = SHAPES[str(rng.choice(list(SHAPES)))]
        texture = textures.poster(rng) if rng.uniform() < 0.3 else textures.surface(rng)
        kind = str(rng.choice(["diffuse", "plastic", "metal"], p=[0.7, 0.15, 0.15]))
        mesh = shape(unit * rng.uniform(0.05, 0.16))
        place = free_place(stage.mitsuba, camera, mesh, rng)
        if place is None:
            continue
        half_view = float((place - origin) @ forward) * np.tan(np.radians(camera.fov / 2))
        step = log_uniform(rng, 3, 16) * 2 * half_view / 256  # pixels a frame of a picture 256 wide
        along = right * rng.choice([-1, 1]) + rng.normal(size=3) * 0.1
        velocity = tuple((along / np.linalg.norm(along) * step).tolist())
        move = Motion(tuple(place.tolist()), start, velocity, spin=float(rng.uniform(-8, 8)))
        material = Material(np.clip(texture, 0.02, 0.92), kind, float(rng.uniform(0.15, 0.4)))
        number = len(scene.objects) + len(extras) + 1
        extras.append(Object(number, "extra", mesh.transform(rigid(np.eye(3), place)), material, motion=move))
    return replace(scene, objects=(*scene.objects, *extras))
