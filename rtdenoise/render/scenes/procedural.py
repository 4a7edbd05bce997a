"""Procedural animated scenes: rooms, half-open rooms and open ground with moving objects, one integer seed each."""

from __future__ import annotations

import numpy as np

from . import meshes, textures
from .meshes import Mesh
from .motions import CameraPath, Motion
from .scene import Material, Object, Scene

VERSION = 1  # of the generator; raise it with every change to the scene of a seed
CLIP_FRAMES = 10  # trajectories are centred on the middle of a clip of this length
PIXELS = 128  # screen speeds are stated for images of this width


class Builder:
    """Collects the objects of a scene while random decisions are made. Ids are given in order of addition."""

    def __init__(self, rng: np.random.Generator):
        self.rng, self.objects = rng, []

    def add(self, name: str, mesh: Mesh, material: Material, **more) -> None:
        self.objects.append(Object(len(self.objects) + 1, name, mesh, material, **more))

    def light(self, mesh: Mesh, strength: float) -> None:
        tint = 1 - self.rng.uniform(0, 0.35, 3)
        self.add("light", mesh, Material(textures.plain(0.1)), emission=tuple((strength * tint).tolist()))

    def material(self, smooth_solid: bool = True) -> Material:
        """Mostly diffuse. Glass for smooth closed shapes only; metal and plastic are rough: mild caustics."""
        roll, texture = self.rng.uniform(), textures.surface(self.rng)
        if roll < 0.72:
            return Material(texture)
        if roll < 0.85:
            return Material(texture, "plastic", float(self.rng.uniform(0.15, 0.4)))
        if roll < 0.96 or not smooth_solid:
            return Material(np.clip(texture + 0.3, 0, 0.95), "metal", float(self.rng.uniform(0.15, 0.45)))
        return Material(textures.plain(1.0), "glass")


def solid(rng: np.random.Generator, radius: float) -> tuple[str, Mesh, bool]:
    """A random shape of about this radius about the origin: (name, mesh, whether smooth and closed)."""
    kind = rng.choice(["box", "sphere", "cylinder", "torus", "blob", "prism", "disc"])
    r = radius
    if kind == "box":
        mesh = meshes.box(r * rng.uniform(0.45, 0.8, 3)).scale_uv(rng.uniform(0.5, 2))
    elif kind == "sphere":
        mesh = meshes.sphere(0.8 * r)
    elif kind == "cylinder":
        mesh = meshes.cylinder(r * rng.uniform(0.3, 0.6), r * rng.uniform(0.4, 0.8))
    elif kind == "torus":
        mesh = meshes.torus(0.7 * r, r * rng.uniform(0.15, 0.3)).scale_uv(2)
    elif kind == "blob":
        mesh = meshes.sphere(0.75 * r, rng, rng.uniform(0.2, 0.5))
    elif kind == "prism":
        mesh = meshes.prism(0.55 * r, 0.8 * r, int(rng.integers(3, 7)), rng.uniform(-3, 3))
    else:
        mesh = meshes.cylinder(0.8 * r, 0.06 * r)
    if kind not in ("sphere", "blob"):  # tilt, about any axis for some and about the vertical for the rest
        axis = rng.normal(size=3) if rng.uniform() < 0.5 else (0, 1, 0)
        mesh = mesh.transform(turn(axis, rng.uniform(0, 360)))
    return str(kind), mesh, kind in ("sphere", "torus", "blob")


def turn(axis, degrees: float) -> np.ndarray:
    return Motion(axis=tuple(float(a) for a in axis), spin=degrees)(1.0)


def moved(mesh: Mesh, offset) -> Mesh:
    return mesh.transform(Motion(velocity=tuple(float(a) for a in offset))(1.0))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


# --- surroundings -----------------------------------------------------------------------------------------------------


def walls(b: Builder, size: np.ndarray, missing: set[str]) -> None:
    """An axis-aligned room: x in ±w/2, y in [0, h], z in [−d, 0]; the camera stands near z = 0 and looks along −z."""
    w, h, d = size
    sides = {
        "floor": meshes.quad((-w / 2, 0, 0), (w, 0, 0), (0, 0, -d)),
        "ceiling": meshes.quad((-w / 2, h, -d), (w, 0, 0), (0, 0, d)),
        "back": meshes.quad((-w / 2, 0, -d), (w, 0, 0), (0, h, 0)),
        "left": meshes.quad((-w / 2, 0, 0), (0, 0, -d), (0, h, 0)),
        "right": meshes.quad((w / 2, 0, -d), (0, 0, d), (0, h, 0)),
        "front": meshes.quad((w / 2, 0, 0), (-w, 0, 0), (0, h, 0)),
    }
    for name, mesh in sides.items():
        if name not in missing:
            texture = textures.surface(b.rng, 0.45 if name == "ceiling" else 0.75)
            b.add(name, mesh.scale_uv(log_uniform(b.rng, 0.25, 1.2)), Material(texture))


def _lamps(b: Builder, size: np.ndarray) -> str:
    """Light for a closed room, mostly hidden, so that much of the room is lit indirectly."""
    w, h, d = size
    rng = b.rng
    a, c = rng.uniform(0.35, 0.8, 2)  # half sizes
    x, z = rng.uniform(-0.25, 0.25) * w, -rng.uniform(0.3, 0.8) * d
    kind = str(rng.choice(["panel", "uplight", "hidden", "window", "window"]))
    if kind == "panel":
        b.light(meshes.quad((x - a, h - 0.02, z - c), (2 * a, 0, 0), (0, 0, 2 * c)), 10)
    elif kind == "uplight":
        y = h * rng.uniform(0.6, 0.8)
        b.light(meshes.quad((x - a, y + 0.05, z + c), (2 * a, 0, 0), (0, 0, -2 * c)), 10)
        b.add("shade", moved(meshes.box((1.1 * a, 0.02, 1.1 * c)), (x, y, z)), b.material(False))
    elif kind == "hidden":
        side = rng.choice([-1, 1])
        x = side * (w / 2 - 0.1)
        edges = ((0, 0, 2 * c), (0, 2 * a, 0)) if side > 0 else ((0, 0, -2 * c), (0, 2 * a, 0))
        corner = (x, h / 2 - a, z - c) if side > 0 else (x, h / 2 - a, z + c)
        b.light(meshes.quad(corner, *edges), 14)
        screen = meshes.box((0.05, 1.5 * a, 1.5 * c))
        b.add("screen", moved(screen, (x - side * rng.uniform(0.5, 0.9), h / 2, z)), b.material(False))
    else:
        side = rng.choice([-1, 1])
        x, z = side * (w / 2 - 0.05), -rng.uniform(0.35, 0.65) * d
        edges = ((0, 0, 2), (0, 1.6, 0)) if side > 0 else ((0, 0, -2), (0, 1.6, 0))
        b.light(meshes.quad((x, 0.9, z - side), *edges), 8)
        if rng.uniform() < 0.6:
            blinds = meshes.bars(2.2, 1.8, int(rng.integers(5, 14)), 0.06, bool(rng.integers(2)))
            blinds = moved(blinds.transform(turn((0, 1, 0), 90)), (x - side * 0.15, 1.7, z))
            b.add("blinds", blinds, b.material(False))
    return kind


def surroundings(b: Builder) -> tuple[str, np.ndarray, np.ndarray | None]:
    """(name, room size (w, h, d), sky)."""
    rng = b.rng
    kind = str(rng.choice(["closed", "half-open", "outdoor"], p=[0.55, 0.25, 0.2]))
    size = rng.uniform((4.0, 2.6, 5.0), (8.0, 4.0, 9.0))
    if kind == "closed":
        walls(b, size, set())
        return f"closed/{_lamps(b, size)}", size, None
    if kind == "half-open":
        gone = [{"ceiling"}, {"left"}, {"right"}, {"ceiling", "left"}, {"front", "ceiling"}, {"front"}]
        walls(b, size, gone[rng.integers(len(gone))])
    else:
        size = size * (2, 1, 2)
        ground = meshes.quad((-40, 0, 40), (80, 0, 0), (0, 0, -80)).scale_uv(log_uniform(rng, 0.2, 0.8))
        b.add("ground", ground, Material(textures.surface(rng, 0.9)))
        for _ in range(rng.integers(1, 4)):
            half = rng.uniform((0.6, 0.8, 0.3), (2.5, 2.5, 1.0))
            at = (rng.uniform(-0.5, 0.5) * size[0], half[1], -size[2] * rng.uniform(0.7, 1.0))
            b.add("block", moved(meshes.box(half).scale_uv(0.6), at), Material(textures.surface(rng, 0.9)))
    return kind, size, textures.sky(rng, sun=bool(rng.uniform() < 0.6))


# --- contents ---------------------------------------------------------------------------------------------------------


def furnish(b: Builder, size: np.ndarray) -> None:
    """Things that stand still: a few solids on the floor, sometimes many small ones, sometimes a fence."""
    rng = b.rng
    w, h, d = size

    def spot(low, high):
        return rng.uniform(-0.42, 0.42) * w, -rng.uniform(low, high) * d

    for _ in range(rng.integers(2, 6)):
        radius = rng.uniform(0.3, 0.8)
        name, mesh, smooth = solid(rng, radius)
        x, z = spot(0.4, 0.92)
        y = -mesh.vertices[:, 1].min() + (0 if rng.uniform() < 0.8 else rng.uniform(0, h - 2 * radius))
        b.add(name, moved(mesh, (x, y, z)), b.material(smooth))
    if rng.uniform() < 0.25:
        for _ in range(rng.integers(10, 24)):
            name, mesh, _ = solid(rng, rng.uniform(0.06, 0.2))
            x, z = spot(0.3, 0.9)
            b.add("small " + name, moved(mesh, (x, -mesh.vertices[:, 1].min(), z)), b.material(False))
    if rng.uniform() < 0.25:
        fence = meshes.bars(w * rng.uniform(0.3, 0.8), rng.uniform(0.8, 2.0), int(rng.integers(6, 18)), 0.05)
        x, z = spot(0.35, 0.7)
        fence = moved(fence.transform(turn((0, 1, 0), rng.uniform(-40, 40))), (x / 2, 0.8, z))
        b.add("fence", fence, b.material(False))


def camera_path(b: Builder, size: np.ndarray, static: bool) -> CameraPath:
    rng = b.rng
    w, h, d = size
    origin = (rng.uniform(-0.2, 0.2) * w, rng.uniform(0.9, min(2.2, h - 0.4)), -rng.uniform(0.25, 0.7))
    target = (rng.uniform(-0.2, 0.2) * w, rng.uniform(0.6, 1.5), -rng.uniform(0.6, 0.9) * d)
    path = dict(origin=origin, target=target, fov=float(rng.uniform(45, 72)), start=(CLIP_FRAMES - 1) / 2)
    kind = "static" if static else str(rng.choice(["dolly", "orbit", "pan", "hand-held"]))
    speed = log_uniform(rng, 0.3, 6) * rng.choice([-1, 1])  # pixels a frame
    degrees = np.degrees(2 * np.tan(np.radians(path["fov"] / 2)) / PIXELS)  # of one pixel at the image's centre
    distance = np.linalg.norm(np.subtract(target, origin))
    if kind == "pan":
        path |= dict(pan=float(speed * degrees))
    elif kind == "orbit":
        path |= dict(orbit=float(np.clip(2 * speed * degrees, -2.5, 2.5)))
    elif kind == "dolly":
        along = rng.normal(size=3) * (1, 0.25, 1)
        step = min(abs(speed) * np.radians(degrees) * distance / 2, 0.06)
        path |= dict(velocity=tuple((along / np.linalg.norm(along) * step).tolist()))
    elif kind == "hand-held":
        path |= dict(shake=float(abs(speed) * degrees), seed=int(rng.integers(1 << 30)))
    return CameraPath(**path)


def _mover(b: Builder, camera: CameraPath, near: bool) -> None:
    """One moving object. A near one crosses the view in front of everything else and uncovers background."""
    rng = b.rng
    view = camera(camera.start)
    right, forward, origin = view.to_world[:3, 0], view.to_world[:3, 2], view.to_world[:3, 3]
    reach = np.linalg.norm(np.subtract(camera.target, camera.origin))
    distance = rng.uniform(0.28, 0.5) * reach if near else rng.uniform(0.45, 0.95) * reach
    half_view = distance * np.tan(np.radians(camera.fov / 2))  # half the width of the view at that distance
    speed = log_uniform(rng, 4, 12) if near else log_uniform(rng, 0.3, 10)
    step = speed * 2 * half_view / PIXELS
    radius = half_view * (rng.uniform(0.3, 0.55) if near else rng.uniform(0.15, 0.4))
    if near and rng.uniform() < 0.15:
        mesh, smooth = meshes.bars(3 * radius, 3.2 * radius, int(rng.integers(3, 7)), 0.25 * radius), False
        name = "moving fence"
    else:
        name, mesh, smooth = solid(rng, radius)
    place = origin + forward * distance + right * half_view * rng.uniform(-0.45, 0.45)
    place[1] += half_view * rng.uniform(-0.3, 0.3)
    place[1] = max(place[1], 0.05 - mesh.vertices[:, 1].min())

    along = right * rng.choice([-1, 1]) + rng.normal(size=3) * (0.15, 0.15, 0.15) if near else rng.normal(size=3)
    along = along / np.linalg.norm(along) * step
    motion = dict(pivot=tuple(place.tolist()), start=camera.start)
    odds = [0.6, 0.25, 0.15, 0] if near else [0.35, 0.2, 0.2, 0.25]
    kind = str(rng.choice(["line", "swing", "orbit", "spin"], p=odds))
    if kind == "line":
        motion |= dict(velocity=tuple(along.tolist()))
    elif kind == "swing":
        period = rng.uniform(14, 48)
        motion |= dict(swing=tuple((along * period / (2 * np.pi)).tolist()), period=float(period))
        motion |= dict(phase=float(rng.uniform(-40, 40) if near else rng.uniform(0, 360)))
    elif kind == "orbit":
        arm = forward * half_view * rng.uniform(0.5, 1.0) * rng.choice([-1, 1])
        motion |= dict(orbit=tuple(arm.tolist()), orbit_speed=float(np.degrees(step / np.linalg.norm(arm))))
    if kind == "spin" or (kind != "orbit" and rng.uniform() < 0.6):
        axis = rng.normal(size=3)
        turn = np.clip(np.degrees(step / radius), 0.5, 12) if kind == "spin" else rng.uniform(-8, 8)
        motion |= dict(axis=tuple((axis / np.linalg.norm(axis)).tolist()), spin=float(turn))
    b.add(f"{name}, {kind}", moved(mesh, place), b.material(smooth), motion=Motion(**motion))


def procedural(seed: int, attempt: int = 0) -> Scene:
    """The scene of an integer seed. The kind of clip depends on the seed alone; `attempt` draws another scene of it."""
    kind = str(np.random.default_rng([VERSION, seed]).choice(["uncovering", "free", "static"], p=[0.64, 0.3, 0.06]))
    rng = np.random.default_rng([VERSION, seed, attempt])
    b = Builder(rng)
    place, size, sky = surroundings(b)
    furnish(b, size)
    camera = camera_path(b, size, kind == "static" or rng.uniform() < 0.26)
    near = rng.integers(1, 4) if kind == "uncovering" else 0
    for k in range(near + (rng.integers(0, 2) if near else rng.integers(1, 5)) if kind != "static" else 0):
        _mover(b, camera, near=k < near)
    facts = {"kind": kind, "place": place, "brightness": log_uniform(rng, 0.1, 2.0), "attempt": attempt}
    return Scene(f"procedural:{seed}", tuple(b.objects), camera, sky, facts=facts)
