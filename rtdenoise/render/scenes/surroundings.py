"""Surroundings of compositions and their light: rooms with lamps and windows, open air, streets of houses."""

from __future__ import annotations

import numpy as np

from . import meshes
from .placing import Composer, metres, plain
from .procedural import log_uniform, moved
from .scene import Spot, Sun


def ground(side: float) -> meshes.Mesh:
    return meshes.quad((-side / 2, 0, side / 2), (side, 0, 0), (0, 0, -side))


def open_air(b: Composer, *tags: str, sun: bool = True) -> dict:
    """An environment map as the only light, or with a sun."""
    light = {"sky": b.sky(*tags)}
    if sun and "outdoor" in tags and b.rng.uniform() < 0.55:
        towards = b.rng.normal(size=3)
        towards[1] = b.rng.uniform(0.35, 1.8)
        towards /= np.linalg.norm(towards)
        brightness = float(light["sky"].mean()) * log_uniform(b.rng, 3, 25)
        colour = np.array([1.0, b.rng.uniform(0.82, 1), b.rng.uniform(0.6, 0.95)])
        light["sun"] = Sun(tuple(towards.tolist()), tuple((brightness * colour).tolist()))
    return light


def shell(b: Composer, w: float, h: float, d: float, glossy: bool = False) -> dict:
    """Floor, ceiling and walls of a room, x in ±w/2, z in [−d, 0], and its light: one to three kinds of lamps."""
    rng = b.rng
    gloss = (0.05, 0.35) if glossy else (0.12, 0.9)
    floor = meshes.quad((-w / 2, 0, 0), (w, 0, 0), (0, 0, -d)).scale_uv(rng.uniform(0.4, 1))
    b.add("floor", floor, b.surface("wood", "tile", "stone", "fabric", roughness=gloss))
    paint = b.surface("plaster", roughness=(0.5, 1), tint=True)
    b.add("ceiling", meshes.quad((-w / 2, h, -d), (w, 0, 0), (0, 0, d)), plain(tuple(rng.uniform(0.55, 0.85, 3))))
    walls = {
        "back": ((-w / 2, 0, -d), (w, 0, 0)), "left": ((-w / 2, 0, 0), (0, 0, -d)),
        "right": ((w / 2, 0, -d), (0, 0, d)), "front": ((w / 2, 0, 0), (-w, 0, 0)),
    }  # fmt: skip
    window = str(rng.choice(["left", "right", "back", "none"], p=[0.3, 0.3, 0.15, 0.25]))
    kinds = rng.choice(["panel", "strips", "globes", "spots"], int(rng.integers(1, 3)), replace=False).tolist()
    light: dict = {"closed": True, "lamps": kinds}
    if window == "none" or rng.uniform() < 0.75:
        _lamps(b, kinds, w, h, d, light)
    for side, (corner, along) in walls.items():
        material = (
            paint if rng.uniform() < 0.7 else b.surface("brick", "plaster", "wood", "pattern", roughness=(0.4, 1))
        )
        if side == window:
            _wall_with_window(b, np.array(corner, float), np.array(along, float), h, material, light)
        else:
            b.add(side, meshes.quad(corner, along, (0, h, 0)).scale_uv(rng.uniform(0.4, 0.9)), material)
    return light


def _lamps(b: Composer, kinds: list[str], w: float, h: float, d: float, light: dict) -> None:
    rng = b.rng
    power = w * d / 12  # larger rooms need more
    if "panel" in kinds:
        for z in -d * (np.arange(n := int(rng.integers(1, 4))) + 0.5) / n:
            a, c = rng.uniform(0.15, 0.5, 2)
            b.light(meshes.quad((-a, h - 0.01, z - c), (2 * a, 0, 0), (0, 0, 2 * c)), 6 * power)
    if "strips" in kinds:
        for x in (-0.42 * w, 0.42 * w):
            b.light(meshes.quad((x - 0.03, h - 0.02, -0.95 * d), (0.06, 0, 0), (0, 0, 0.9 * d)), 14 * power)
    if "globes" in kinds:
        for _ in range(int(rng.integers(1, 5))):
            x, y, z = rng.uniform((-0.3 * w, 0.6 * h, -0.85 * d), (0.3 * w, 0.85 * h, -0.25 * d))
            radius = rng.uniform(0.05, 0.16)
            b.light(moved(meshes.sphere(radius), (x, y, z)), 0.7 * power / radius**2)
            cord = meshes.cylinder(0.006, (h - y - radius) / 2)
            b.add("cord", moved(cord, (x, (h + y + radius) / 2, z)), plain(0.05))
    if "spots" in kinds:
        light["spots"] = tuple(_spot(rng, w, h, d, power) for _ in range(int(rng.integers(2, 6))))


def _spot(rng: np.random.Generator, w: float, h: float, d: float, power: float) -> Spot:
    origin = rng.uniform((-0.4 * w, 0.95 * h, -0.9 * d), (0.4 * w, 0.97 * h, -0.1 * d))
    target = rng.uniform((-0.4 * w, 0, -0.9 * d), (0.4 * w, 0.8, -0.2 * d))
    intensity = rng.uniform(10, 45) * power * (1 - rng.uniform(0, 0.4, 3))
    return Spot(*(tuple(v.tolist()) for v in (origin, target, intensity)), float(rng.uniform(15, 40)))


def _wall_with_window(b: Composer, corner, along, h: float, material, light: dict) -> None:
    """A wall with an opening: open to sky and sun, or closed by a bright pane; with bars in it or not."""
    rng = b.rng
    length = np.linalg.norm(along)
    along, up = along / length, np.array([0, 1.0, 0])
    left, right = length * rng.uniform(0.12, 0.3), length * rng.uniform(0.7, 0.88)
    low, high = rng.uniform(0.1, 0.9), h * rng.uniform(0.8, 0.92)
    pieces = [(0, length, 0, low), (0, length, high, h), (0, left, low, high), (right, length, low, high)]
    wall = meshes.merge(
        [meshes.quad(corner + u * along + v * up, (w - u) * along, (t - v) * up) for u, w, v, t in pieces]
    )
    b.add("wall with window", wall.scale_uv(rng.uniform(0.4, 0.9)), material)
    outwards = np.cross(up, along)
    place, width, height = corner + left * along + low * up, right - left, high - low
    if rng.uniform() < 0.5:
        b.light(meshes.quad(place + 0.05 * outwards, width * along, height * up), log_uniform(rng, 3, 60), tint=0.15)
        light["window"] = "pane"
    else:
        light |= {"window": "open", "sky": b.sky("outdoor") * np.float32(log_uniform(rng, 1, 6))}
        if rng.uniform() < 0.6:
            towards = outwards + rng.normal(size=3) * (0.5, 0, 0.5)
            towards[1] = rng.uniform(0.3, 0.9)
            towards /= np.linalg.norm(towards)
            light["sun"] = Sun(
                tuple(towards.tolist()), tuple((log_uniform(rng, 5, 60) * np.array([1, 0.93, 0.8])).tolist())
            )
    if rng.uniform() < 0.7:
        bars = meshes.bars(width, height, int(rng.integers(2, 6)), 0.05)
        if rng.uniform() < 0.3:  # blinds
            bars = meshes.bars(width, height, int(rng.integers(10, 30)), 0.015, horizontal=True)
        matrix = np.eye(4)
        matrix[:3, :3] = np.stack([along, up, -outwards], 1)
        matrix[:3, 3] = place + width / 2 * along + height / 2 * up
        b.add("window bars", bars.transform(matrix), plain(tuple(rng.uniform(0.1, 0.8, 3))))


def against_wall(b: Composer, w: float, d: float) -> None:
    """A piece of furniture with its back to a wall."""
    asset = b.choose("furniture", "electronics", "kitchen", "lamp", "instrument", "bathroom", longest=(0.6, 2.8))
    if asset is None:
        return
    for _ in range(4):
        depth = metres(asset)[2] / 2 + 0.04
        side, share = str(b.rng.choice(["back", "left", "right"])), b.rng.uniform(0.12, 0.88)
        place, heading = {
            "back": ((w * (share - 0.5), 0, depth - d), 0), "left": ((depth - w / 2, 0, -d * share), 90),
            "right": ((w / 2 - depth, 0, -d * share), -90),
        }[side]  # fmt: skip
        if b.put(asset, place, heading):
            return


def picture_on_wall(b: Composer, w: float, h: float, d: float) -> None:
    width, height = b.rng.uniform(0.3, 1.0, 2)
    y, share = b.rng.uniform(0.5 * h, max(h - height - 0.2, 0.51 * h)), b.rng.uniform(0.15, 0.8)
    x = w / 2 - 0.015
    places = {
        "back": ((w * (share - 0.5), y, 0.015 - d), (width, 0, 0)),
        "left": ((-x, y, -d * share), (0, 0, -width)), "right": ((x, y, -d * share), (0, 0, width)),
    }  # fmt: skip
    corner, along = places[str(b.rng.choice(list(places)))]
    b.picture(corner, along, (0, height, 0))


def houses(b: Composer, x: float, side: int, night: bool) -> None:
    """A row of boxes with windows along a street; `x` is their front."""
    rng, z = b.rng, 8.0
    while z > -45:
        width, height, depth = rng.uniform((5, 5, 6), (11, 14, 9))
        front = meshes.box((depth / 2, height / 2, width / 2 - rng.uniform(0, 0.6)))
        wall = b.surface("brick", "plaster", "stone", roughness=(0.6, 1), tint=True)
        b.add("house", moved(front, (x + side * depth / 2, height / 2, z - width / 2)).scale_uv(0.4), wall)
        columns, floors = int(width // 1.8), int(height // 2.8)
        panes, lit = [], []
        for i in range(columns):
            for j in range(floors):
                at = np.array([x - side * 0.02, 0.9 + 2.8 * j, z - (i + 0.5) * width / columns + side * 0.5])
                pane = meshes.quad(at, (0, 0, -side * 1.0), (0, 1.5, 0))
                (lit if night and rng.uniform() < 0.4 else panes).append(pane)
        if panes:
            b.add("windows", meshes.merge(panes), plain(0.03, rng.uniform(0.04, 0.15)))
        if lit:
            b.light(meshes.merge(lit), rng.uniform(1, 4))
        z -= width
