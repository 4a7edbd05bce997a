"""Rooms full of caustics, one integer seed each: light that glass and metal throw on floors and walls.

A closed room holds three to seven things near each other: half of them of glass, three in ten of plastic, the rest of
metal, and at least one of glass. One small disc gives most of the light and moves; a dim panel lights the shadows. No
lamp is a point: no path finds the light of a point through smooth glass. The camera moves slowly; in half of the scenes
one thing moves, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import meshes, textures
from .meshes import Mesh
from .motions import CameraPath, Motion, rigid
from .procedural import Builder, log_uniform, moved, solid, walls
from .scene import Material, Scene

VERSION = 1  # of the generator; raise it with every change to the scene of a seed
CAUSTIC_DEPTH = 8  # path edges that light needs through two things of glass: lamp, four surfaces, floor, wall, camera
FRAMES = 12
KINDS = {"glass": 0.5, "plastic": 0.3, "metal": 0.2}


def _material(kind: str, rng: np.random.Generator) -> Material:
    if kind == "glass":
        return Material(textures.plain(1.0), "glass")
    if kind == "metal":
        return Material(np.clip(textures.surface(rng, 0.2) * 0.4 + 0.55, 0, 0.95), "metal", log_uniform(rng, 0.05, 0.2))
    return Material(textures.surface(rng), "plastic", float(rng.uniform(0.05, 0.2)))


def _thing(kind: str, rng: np.random.Generator, radius: float) -> tuple[str, Mesh]:
    """A shape of this radius; glass takes the smooth and closed ones."""
    while True:
        name, mesh, smooth = solid(rng, radius)
        if smooth or kind != "glass":
            return name, mesh


def _floor(b: Builder, size: np.ndarray) -> None:
    """A light floor, on which caustics show; half of the time without any pattern."""
    w, _, d = size
    texture = textures.plain(textures.colour(b.rng, 0.5, 0.85))
    if b.rng.uniform() < 0.5:
        texture = 0.6 * texture + 0.4 * textures.surface(b.rng)
    floor = meshes.quad((-w / 2, 0, 0), (w, 0, 0), (0, 0, -d)).scale_uv(log_uniform(b.rng, 0.25, 1.2))
    b.add("floor", floor, Material(np.clip(texture, 0.02, 0.9)))


def _disc(radius: float, place: np.ndarray, target: np.ndarray) -> Mesh:
    """A disc at `place` that faces `target`."""
    down = (target - place) / np.linalg.norm(target - place)
    side = np.cross(down, (0.0, 0.0, 1.0) if abs(down[2]) < 0.9 else (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    turn = np.stack([side, -down, np.cross(side, -down)], 1)
    return meshes.disc(radius, -1e-3).transform(rigid(turn, place))


def _lights(b: Builder, size: np.ndarray, middle: np.ndarray, frames: int) -> None:
    """The small lamp, that moves, and the dim panel under the ceiling."""
    rng = b.rng
    w, h, d = size
    radius = float(rng.uniform(0.01, 0.03) * size.mean())
    place = middle + np.array([rng.uniform(-0.3, 0.3) * w, 0, rng.uniform(-0.25, 0.2) * d])
    place[1] = h * rng.uniform(0.6, 0.95)
    half = rng.uniform(0.25, 0.5)
    dim = float(rng.uniform(0.3, 0.8))
    strength = dim * 4 * half**2 / (np.pi * radius**2) * log_uniform(rng, 4, 16)
    travel = float(rng.uniform(0.02, 0.06))  # metres a frame
    heading = rng.uniform(0, 2 * np.pi)
    along = np.array([np.cos(heading), 0.0, np.sin(heading)]) * travel
    motion = Motion(tuple(place.tolist()), (frames - 1) / 2, velocity=tuple(along.tolist()))
    if rng.uniform() < 0.5:
        period = float(rng.uniform(16, 40))
        swing = along * period / (2 * np.pi)
        motion = replace(motion, velocity=(0.0, 0.0, 0.0), swing=tuple(swing.tolist()), period=period)
    tint = 1 - rng.uniform(0, 0.35, 3)
    emission = tuple((strength * tint).tolist())
    b.add("lamp", _disc(radius, place, middle), Material(textures.plain(0.1)), emission=emission, motion=motion)
    x, z = rng.uniform(-0.3, 0.3) * w, -rng.uniform(0.3, 0.7) * d
    b.light(meshes.quad((x - half, h - 0.02, z - half), (2 * half, 0, 0), (0, 0, 2 * half)), dim)


def _things(b: Builder, middle: np.ndarray, frames: int) -> None:
    rng = b.rng
    count = int(rng.integers(3, 8))
    kinds = rng.choice(list(KINDS), count, p=list(KINDS.values()))
    if "glass" not in kinds:
        kinds[0] = "glass"
    moving = int(rng.integers(count)) if rng.uniform() < 0.5 else -1
    for i, kind in enumerate(kinds):
        radius = float(rng.uniform(0.2, 0.45))
        name, mesh = _thing(str(kind), rng, radius)
        angle, far = 2.4 * i + rng.uniform(-0.4, 0.4), 0.42 * np.sqrt(i + 0.3)
        lift = 0.0 if rng.uniform() < 0.7 else rng.uniform(0.05, 0.8)
        place = middle + np.array([far * np.cos(angle), 0, far * np.sin(angle)])
        place[1] = lift - mesh.vertices[:, 1].min()
        motion = None
        if i == moving:
            along, spin = rng.normal(size=3) * (0.02, 0.0, 0.02), float(rng.uniform(-6, 6))
            motion = Motion(tuple(place.tolist()), (frames - 1) / 2, tuple(along.tolist()), spin=spin)
        b.add(f"{kind} {name}", moved(mesh, place), _material(str(kind), rng), motion=motion)


def _camera(rng: np.random.Generator, middle: np.ndarray, frames: int) -> CameraPath:
    """Looks down on the things from in front, and moves a little."""
    heading, distance = rng.uniform(-0.7, 0.7), rng.uniform(1.6, 2.4)
    origin = middle + np.array([distance * np.sin(heading), rng.uniform(1.0, 1.9), distance * np.cos(heading)])
    target = middle + np.array([rng.uniform(-0.2, 0.2), rng.uniform(0.0, 0.35), rng.uniform(-0.3, 0.3)])
    slow = log_uniform(rng, 0.1, 1.0) * rng.choice([-1, 1])
    path = dict(origin=tuple(origin.tolist()), target=tuple(target.tolist()), fov=float(rng.uniform(42, 62)))
    kind = str(rng.choice(["orbit", "dolly", "hand-held", "static"], p=[0.35, 0.3, 0.25, 0.1]))
    if kind == "orbit":
        path |= dict(orbit=float(0.8 * slow))
    elif kind == "dolly":
        along = rng.normal(size=3) * (1, 0.25, 1)
        path |= dict(velocity=tuple((0.03 * slow * along / np.linalg.norm(along)).tolist()))
    elif kind == "hand-held":
        path |= dict(shake=float(0.6 * abs(slow)), seed=int(rng.integers(1 << 30)))
    return CameraPath(**path, start=(frames - 1) / 2)


def caustic(seed: int, frames: int = FRAMES) -> Scene:
    """The scene of an integer seed, with motions whose middle is that of a clip of `frames`."""
    rng = np.random.default_rng([VERSION, seed, 0xCA])
    b = Builder(rng)
    size = rng.uniform((4.5, 2.6, 6.5), (7.0, 3.6, 8.0))
    walls(b, size, {"floor"})
    _floor(b, size)
    middle = np.array([rng.uniform(-0.5, 0.5), 0.0, -0.58 * size[2]])
    _things(b, middle, frames)
    _lights(b, size, middle, frames)
    camera = _camera(rng, middle, frames)
    facts = {"kind": "caustic", "place": "closed", "brightness": log_uniform(rng, 0.15, 0.8), "scene_seed": seed}
    return Scene(f"caustic:{seed}", tuple(b.objects), camera, facts=facts)
