"""The wide generator of procedural scenes, versions 2 and 3; `procedural` is version 1.

To the rooms, furniture and cameras of version 1 it adds spot lights, cloudy skies, pictures on walls, plants with thin
leaves, heaps of small things, more metal and glass. It draws clips of these kinds:

| kind          | what happens                                                              | share |
|---------------|---------------------------------------------------------------------------|-------|
| uncovering    | one to three near objects cross the view                                   | 0.34  |
| entering      | a near object comes in from the border of the view                         | 0.16  |
| dark to light | a fast object in front of a backdrop that is black on one side, white on the other | 0.12 |
| flock         | five to ten small objects, each its own way                                | 0.10  |
| free          | one to four objects anywhere, slow and fast                                | 0.10  |
| cut           | the camera jumps to another place, objects move on                         | 0.08  |
| camera        | only the camera moves                                                      | 0.06  |
| static        | nothing moves                                                              | 0.04  |

In the kinds with moving objects the camera stands still in three clips of ten. One more kind is drawn on request: in
`calm` only the camera moves, slowly; leaves may stir.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from . import meshes, textures
from .motions import CameraPath, Motion, Shots
from .procedural import Builder, camera_path, furnish, log_uniform, moved, solid, surroundings, turn
from .scene import Material, Scene, Spot

VERSION = 3
KINDS = {
    "uncovering": 0.34, "entering": 0.16, "dark to light": 0.12, "flock": 0.10, "free": 0.10, "cut": 0.08,
    "camera": 0.06, "static": 0.04,
}  # fmt: skip


@dataclass(frozen=True)
class Role:
    """Ranges that a moving object is drawn from: distance in front of the camera (share of the camera's reach), speed
    (pixels a frame), radius (share of half the view's width there); and whether it crosses from side to side."""

    distance: tuple[float, float]
    speed: tuple[float, float]
    radius: tuple[float, float]
    crosses: bool


NEAR = Role((0.28, 0.5), (4, 16), (0.2, 0.45), True)
ENTERING = Role((0.3, 0.7), (6, 18), (0.2, 0.45), True)
FAST = Role((0.3, 0.5), (18, 40), (0.12, 0.3), True)
FREE = Role((0.45, 0.95), (0.3, 14), (0.08, 0.35), False)
SMALL = Role((0.3, 0.9), (1, 16), (0.03, 0.09), False)


class WideBuilder(Builder):
    """More plastic, metal and glass than the first generator."""

    def material(self, smooth_solid: bool = True) -> Material:
        kind = str(self.rng.choice(["diffuse", "plastic", "metal", "glass"], p=[0.58, 0.17, 0.14, 0.11]))
        texture = textures.poster(self.rng) if self.rng.uniform() < 0.2 else textures.surface(self.rng)
        if kind == "glass" and smooth_solid:
            return Material(textures.plain(1.0), "glass")
        if kind == "metal":
            return Material(np.clip(texture + 0.3, 0, 0.95), "metal", float(self.rng.uniform(0.12, 0.45)))
        return Material(texture, "plastic" if kind == "plastic" else "diffuse", float(self.rng.uniform(0.12, 0.4)))


# --- things that stand still ------------------------------------------------------------------------------------------


def _decorate(b: WideBuilder, size: np.ndarray) -> None:
    """Thin and small geometry, and pictures: each in some scenes."""
    rng = b.rng
    w, h, d = size
    if rng.uniform() < 0.35:
        radius, sway = rng.uniform(0.35, 0.8), rng.uniform(0.0, 0.04)
        place = (rng.uniform(-0.4, 0.4) * w, rng.uniform(0.4, 0.9) * h / 2 + 0.3, -rng.uniform(0.35, 0.8) * d)
        motion = Motion(
            swing=(sway, 0.0, sway / 2), period=float(rng.uniform(10, 30)), phase=float(rng.uniform(0, 360))
        )
        leaves = moved(plant(rng, radius), place)
        b.add("leaves", leaves, Material(textures.surface(rng, 0.4)), motion=motion if rng.uniform() < 0.5 else None)
    if rng.uniform() < 0.35:
        parts = [solid(rng, rng.uniform(0.03, 0.12))[1] for _ in range(int(rng.integers(20, 60)))]
        x, z = rng.uniform(-0.3, 0.3) * w, -rng.uniform(0.35, 0.7) * d
        scattered = [moved(m, (x + rng.normal() * 0.7, -m.vertices[:, 1].min(), z + rng.normal() * 0.5)) for m in parts]
        b.add("small things", meshes.merge(scattered), b.material(False))
    for _ in range(int(rng.integers(0, 3))):
        a, c = rng.uniform(0.3, 0.8, 2)
        corner = (rng.uniform(-0.4, 0.2) * w, rng.uniform(0.3, 0.6) * h, -d + 0.06)
        picture = meshes.quad(corner, (2 * a, 0, 0), (0, c, 0)).scale_uv(1 / (2 * a))
        b.add("picture", picture, Material(textures.poster(rng)))


def plant(rng: np.random.Generator, radius: float) -> meshes.Mesh:
    """Flat leaves, seen from both sides, all over an ellipsoid about the origin."""
    leaves = []
    for _ in range(int(rng.integers(30, 90))):
        direction = rng.normal(size=3)
        place = direction / np.linalg.norm(direction) * radius * rng.uniform(0.3, 1.0) * (1, 1.3, 1)
        length, width = rng.uniform(0.08, 0.2), rng.uniform(0.01, 0.05)
        leaf = meshes.quad((-width, 0, 0), (2 * width, 0, 0), (0, length, 0))
        leaf = leaf.transform(turn(rng.normal(size=3), rng.uniform(0, 360)))
        leaves += [moved(leaf, place), moved(leaf.flip(), place)]
    return meshes.merge(leaves)


def _spots(rng: np.random.Generator, size: np.ndarray) -> tuple[Spot, ...]:
    w, h, d = size
    spots = []
    for _ in range(int(rng.integers(1, 3))):
        origin = (rng.uniform(-0.4, 0.4) * w, 0.92 * h, -rng.uniform(0.1, 0.8) * d)
        target = (rng.uniform(-0.3, 0.3) * w, 0.0, -rng.uniform(0.4, 0.9) * d)
        light = rng.uniform(10, 50) * (1 - rng.uniform(0, 0.4, 3))
        spots.append(Spot(*(tuple(map(float, v)) for v in (origin, target, light)), float(rng.uniform(15, 45))))
    return tuple(spots)


def _backdrop(b: WideBuilder, camera: CameraPath) -> None:
    """A screen across the view, upright, black to one side and white to the other."""
    view = camera(camera.start).to_world
    right, forward, origin = view[:3, 0], view[:3, 2], view[:3, 3]
    reach = np.linalg.norm(np.subtract(camera.target, camera.origin))
    half = reach * np.tan(np.radians(camera.fov / 2))
    image = textures.plain(b.rng.uniform(0.02, 0.05))
    border = int(textures.SIZE * b.rng.uniform(0.35, 0.65))
    image[:, border:] = b.rng.uniform(0.75, 0.92)
    image = image[:, ::-1].copy() if b.rng.uniform() < 0.5 else image
    edge = 2.2 * half * right
    corner = origin + 0.8 * reach * forward - edge / 2 - (0, half, 0)
    mesh = meshes.quad(corner, edge, (0, 2 * half, 0))
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    b.add("backdrop", replace(mesh, uv=uv), Material(image))


# --- things that move -------------------------------------------------------------------------------------------------


def add_mover(b: Builder, camera: CameraPath, role: Role, frames: int, width: int) -> None:
    """Add an object that moves as `role` says, in a picture `width` pixels wide.

    Crossing objects pass the middle of the view about the middle of the clip; ENTERING ones come in from the border in
    its first half.
    """
    rng = b.rng
    view = camera(camera.start)
    right, forward, origin = view.to_world[:3, 0], view.to_world[:3, 2], view.to_world[:3, 3]
    distance = rng.uniform(*role.distance) * np.linalg.norm(np.subtract(camera.target, camera.origin))
    half_view = distance * np.tan(np.radians(camera.fov / 2))
    step = log_uniform(rng, *role.speed) * 2 * half_view / width  # a frame
    radius = half_view * rng.uniform(*role.radius)
    name, mesh, smooth = solid(rng, radius)
    side = rng.choice([-1, 1])
    across = half_view * rng.uniform(-0.6, 0.6)
    if role is ENTERING:
        across = side * (step * (camera.start - rng.uniform(1, frames / 2)) - half_view - radius)
    place = origin + forward * distance + right * across
    place[1] = max(place[1] + half_view * rng.uniform(-0.35, 0.35), 0.05 - mesh.vertices[:, 1].min())

    along = right * side + rng.normal(size=3) * 0.12 if role.crosses else rng.normal(size=3)
    along = along / np.linalg.norm(along) * step
    motion = dict(pivot=tuple(place.tolist()), start=camera.start)
    kind = "line" if role.crosses and rng.uniform() < 0.75 else str(rng.choice(["line", "swing", "orbit"]))
    if role is ENTERING or kind == "line":
        motion |= dict(velocity=tuple(along.tolist()))
    elif kind == "swing":
        period = float(rng.uniform(14, 48))
        motion |= dict(swing=tuple((along * period / (2 * np.pi)).tolist()), period=period)
    else:
        arm = forward * half_view * rng.uniform(0.5, 1.0) * side
        motion |= dict(orbit=tuple(arm.tolist()), orbit_speed=float(np.degrees(step / np.linalg.norm(arm))))
    if rng.uniform() < 0.6:
        axis = rng.normal(size=3)
        motion |= dict(axis=tuple((axis / np.linalg.norm(axis)).tolist()), spin=float(rng.uniform(-8, 8)))
    b.add(f"moving {name}", moved(mesh, place), b.material(smooth), motion=Motion(**motion))


def _streams(seed: int, attempt: int, version: int) -> list[np.random.Generator]:
    """Random numbers for the kind of clip, and for everything else.

    numpy treats keys that differ only in trailing zeros as equal. Version 2 has such keys: at the first attempt the
    same number draws kind and place, so that objects cross the view in closed rooms only.
    """
    keys = ([seed], [seed, attempt]) if version == 2 else ([seed, 1], [seed, attempt + 2])
    return [np.random.default_rng([version, *key]) for key in keys]


def procedural(
    seed: int, attempt: int = 0, frames: int = 20, width: int = 256, version: int = VERSION, calm: bool = False
) -> Scene:
    """The scene of an integer seed, with speeds for a clip of `frames` and pictures `width` pixels wide.

    The kind of clip depends on the seed alone, or on `calm`; `attempt` draws another scene of that kind.
    """
    kind_rng, rng = _streams(seed, attempt, version)
    kind = "calm" if calm else str(kind_rng.choice(list(KINDS), p=list(KINDS.values())))
    b = WideBuilder(rng)
    place, size, sky = surroundings(b)
    if sky is not None and rng.uniform() < 0.5:
        sky = (sky * (0.6 + 0.8 * textures.fractal(rng)[:: textures.SIZE // textures.SKY[0], :, None])).astype(
            np.float32
        )
    furnish(b, size)
    _decorate(b, size)
    spots = _spots(rng, size) if rng.uniform() < 0.25 else ()

    still = kind == "static" or (kind not in ("camera", "calm") and rng.uniform() < 0.3)
    start = (frames - 1) / 2
    camera: CameraPath | Shots = replace(camera_path(b, size, still), start=start)
    if calm:
        camera = camera.slowed(log_uniform(rng, 0.05, 0.5))
    path = camera
    if kind == "dark to light":
        _backdrop(b, path)
    roles = {
        "uncovering": [NEAR] * int(rng.integers(1, 4)) + [FREE] * int(rng.integers(0, 2)),
        "entering": [ENTERING] * int(rng.integers(1, 3)) + [FREE] * int(rng.integers(0, 2)),
        "dark to light": [FAST] * int(rng.integers(1, 3)),
        "flock": [SMALL] * int(rng.integers(5, 11)),
        "free": [FREE] * int(rng.integers(1, 5)),
        "cut": [NEAR] * int(rng.integers(1, 3)) + [FREE],
    }
    for role in roles.get(kind, []):
        add_mover(b, path, role, frames, width)
    if kind == "cut":
        other = replace(camera_path(b, size, rng.uniform() < 0.5), start=start)
        camera = Shots((path, other), (int(rng.integers(frames // 3, 2 * frames // 3)),))
    facts = {"kind": kind, "place": place, "brightness": log_uniform(rng, 0.1, 2.0), "attempt": attempt}
    return Scene(f"wide:{seed}", tuple(b.objects), camera, sky, spots=spots, facts=facts)
