"""A sun and windows for generated scenes: sharp shadows with little noise.

The generators' lamps and skies are wide and their shadows soft; a network that has seen only these takes a sharp shadow
for noise and blurs it. A closed room loses a side to let the sun in; half of the time something stands in its way.
Lamps are black here, as in most scenes that people make: they reflect nothing, so no indirect light comes from them.
Some are windows in the wall that the camera looks at.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import meshes, textures
from .meshes import Mesh
from .motions import rigid
from .procedural import log_uniform
from .scene import Material, Object, Scene, Sun
from .wide import plant

OPEN_TO = {"left": (-1, 0, 0), "right": (1, 0, 0), "front": (0, 0, 1), "ceiling": (0, 1, 0)}  # side -> where the sun is
PANELS = {"none": 0.5, "slats": 0.25, "grid": 0.15, "leaves": 0.1}
BLACK = Material(textures.plain(0.0))
HALF = 3.0  # half the side of a panel in the sun's way; scenes are metres in size


def sunlit(scene: Scene, rng: np.random.Generator) -> Scene:
    """A procedural scene with a sun that shines into it."""
    names = {o.name for o in scene.objects}
    side = None
    if "floor" in names:  # a room: the sun comes through an open side, or one that is opened now
        side = str(rng.choice([s for s in OPEN_TO if s not in names] or list(OPEN_TO)))
        scene = replace(scene, objects=tuple(o for o in scene.objects if o.name != side))
    sun = _sun(OPEN_TO.get(side, (0, 0.6, 0)), rng)

    kind = str(rng.choice(list(PANELS), p=list(PANELS.values())))
    objects = _windows(tuple(_unlit(o) for o in scene.objects), rng)
    if kind != "none":
        mesh = _outside(_panel(kind, rng), scene, np.array(sun.towards), rng)
        objects = (*objects, Object(max(o.id for o in objects) + 1, kind, mesh, Material(textures.surface(rng))))
    return replace(scene, objects=objects, sun=sun, facts=scene.facts | {"sun_from": side, "sun_through": kind})


def _sun(about: tuple[float, float, float], rng: np.random.Generator) -> Sun:
    """A sun from about this direction, always from above, yellow rather than blue."""
    towards = rng.normal(size=3) * 0.6 + np.array(about)
    towards[1] = abs(towards[1]) + 0.2
    towards /= np.linalg.norm(towards)
    green = rng.uniform(0.8, 1)
    irradiance = log_uniform(rng, 2, 30) * np.array([1, green, green * rng.uniform(0.75, 1)])
    weight = log_uniform(rng, 0.5, 8)  # decides how noisy the other lights are at one sample a pixel
    return Sun(tuple(towards.tolist()), tuple(irradiance.tolist()), weight)


def _unlit(o: Object) -> Object:
    """A lamp reflects nothing; any other object stays."""
    return o if o.emission is None else replace(o, material=BLACK)


def _windows(objects: tuple[Object, ...], rng: np.random.Generator) -> tuple[Object, ...]:
    """The objects with up to two windows in the back wall, if there is one; some windows have bars."""
    back = next((o.mesh.vertices for o in objects if o.name == "back"), None)
    added: list[Object] = []
    for _ in range(int(rng.integers(3)) if back is not None else 0):
        width, height = rng.uniform(0.5, 2.0, 2)
        low = np.array([rng.uniform(back[:, 0].min(), back[:, 0].max() - width), rng.uniform(0.2, 1.5)])
        z = float(back[0, 2]) + rng.uniform(0.02, 0.05)
        glow = tuple((log_uniform(rng, 1, 15) * rng.uniform(0.6, 1, 3)).tolist())
        pane = meshes.quad((*low, z), (width, 0, 0), (0, height, 0))
        first = max(o.id for o in objects) + len(added) + 1
        added.append(Object(first, "window", pane, BLACK, emission=glow))
        if rng.uniform() < 0.5:
            bars = meshes.bars(width, height, int(rng.integers(2, 9)), rng.uniform(0.03, 0.08), rng.uniform() < 0.5)
            place = rigid(np.eye(3), (low[0] + width / 2, low[1] + height / 2, z + 0.1))
            added.append(Object(first + 1, "bars", bars.transform(place), Material(textures.surface(rng))))
    return objects + tuple(added)


def _outside(mesh: Mesh, scene: Scene, towards: np.ndarray, rng: np.random.Generator) -> Mesh:
    """A mesh about the origin, across the z axis, moved outside the room to a point between the sun and a place in the
    camera's view."""
    walls = [o.mesh.vertices for o in scene.objects if o.name in ("floor", "back", *OPEN_TO)]
    corners = np.concatenate(walls) if walls else np.array([[-4.0] * 3, [4.0] * 3])
    low, high = corners.min(0), corners.max(0)
    view = scene.camera(0).to_world
    seen = np.clip(view[:3, 3] + view[:3, 2] * rng.uniform(2, 5), low, high)
    x = np.cross((0.02, 1, 0.01), towards)  # about level
    x /= np.linalg.norm(x)
    turned = mesh.transform(rigid(np.stack([x, np.cross(towards, x), towards], axis=1), seen))
    with np.errstate(divide="ignore"):
        # How far along the sun's direction the last vertex passes each side of the room; the nearest side is enough.
        past = np.where(towards > 0, high - turned.vertices.min(0), low - turned.vertices.max(0)) / towards
    away = 0.1 + min(p for p in past if np.isfinite(p))
    return turned.transform(rigid(np.eye(3), away * towards))


def _panel(kind: str, rng: np.random.Generator) -> Mesh:
    """A mesh with gaps, across the z axis."""
    if kind == "leaves":
        return plant(rng, 0.5).transform(np.diag([2 * HALF, 2 * HALF, 2 * HALF, 1]))
    period = log_uniform(rng, 0.08, 0.8)
    count, thickness = int(2 * HALF / period), period * rng.uniform(0.25, 0.6)
    level = meshes.bars(2 * HALF, 2 * HALF, count, thickness, horizontal=True)
    if kind == "slats":
        return level if rng.uniform() < 0.7 else meshes.bars(2 * HALF, 2 * HALF, count, thickness)
    return meshes.merge([level, meshes.bars(2 * HALF, 2 * HALF, count, thickness)])
