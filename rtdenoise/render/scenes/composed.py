"""Scenes composed of a library's assets: furnished rooms, streets, table tops, gardens and showrooms.

World space is in metres, +y up, the ground at y = 0. A composition says where things are; cameras and motions are drawn
for it by `takes`, several for one composition, so that a renderer loads it once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from . import meshes
from .assets import Library
from .motions import Motion
from .placing import Composer, Thing, glass, metres, plain
from .procedural import log_uniform, moved
from .scene import Object, Scene, Spot, Sun

VERSION = 1  # whoever changes the composition of a seed raises it
MOVERS = 6  # things that can move
PARKED = -60.0  # height at which things wait that cross the view of a take
SMALL = ("kitchen", "food", "electronics", "toy", "tools", "bathroom", "clothing", "plant", "statue", "lamp", "picture",
         "misc", "animal", "rock")  # fmt: skip


@dataclass(frozen=True)
class Composition:
    """A scene without a camera, and how it can be filmed."""

    scene: Scene
    things: tuple[Thing, ...]  # that cameras can look at
    movers: tuple[Thing, ...]  # whose objects have a motion
    parked: tuple[Thing, ...]  # out of sight; their objects have a motion
    low: np.ndarray  # [3] corners of the box that cameras stay in
    high: np.ndarray
    reach: tuple[float, float]  # distance from the camera to its subject
    fov: tuple[float, float]


def compose(library: Library, seed: int) -> Composition:
    """The composition of an integer seed. Raises InputError where no asset of a needed kind can be loaded."""
    rng = np.random.default_rng([VERSION, seed])
    kind = str(rng.choice(list(KINDS), p=[share for share, _ in KINDS.values()]))
    b = Composer(library, rng)
    return KINDS[kind][1](b, f"composed:{seed}", kind)


# --- places -----------------------------------------------------------------------------------------------------------


def _room(b: Composer, name: str, kind: str) -> Composition:
    """Furniture along the walls and a group of seats around a table; light from lamps, windows or both."""
    rng = b.rng
    w, h, d = rng.uniform((3.6, 2.4, 4.5), (7.5, 3.3, 8.5))
    light = _shell(b, w, h, d)
    table = b.put(b.choose("furniture", longest=(0.9, 2.4), word="table"), (rng.uniform(-0.5, 0.5), 0, -d / 2), 0)
    for angle in rng.uniform(0, 90) + np.arange(0, 360, 90) if table else ():
        away = np.radians(angle)
        out = np.hypot(*(table.size[[0, 2]] * (np.sin(away), np.cos(away)))) / 2 + 0.4
        place = table.centre * (1, 0, 1) + out * np.array([np.sin(away), 0, np.cos(away)])
        b.put(b.choose("furniture", word="chair"), place, angle + 180 + rng.uniform(-12, 12), margin=0)
    for _ in range(int(rng.integers(5, 10))):
        _against_wall(b, w, d)
    if rng.uniform() < 0.6:
        rug = moved(meshes.box((rng.uniform(0.8, 1.6), 0.006, rng.uniform(0.6, 1.2))), (0, 0.006, -d / 2))
        b.add("rug", rug.scale_uv(1 / 1.2), b.surface("fabric", "pattern", roughness=(0.7, 1.0), tint=True))
    low, high = (-w / 2 + 0.3, -d + 0.3), (w / 2 - 0.3, -0.3)
    b.scatter(int(rng.integers(2, 6)), low, high, "plant", "misc", "toy", "animal", "thin", longest=(0.15, 1.9))
    if rng.uniform() < 0.5:
        b.scatter(1, low, high, "people", longest=(1.1, 2.1))
    for surface in [thing for thing in b.things if thing.top and 0.3 < thing.top < 1.3]:
        b.set_table(surface, int(rng.integers(2, 7)), *SMALL)
    for _ in range(int(rng.integers(1, 5))):
        _picture_on_wall(b, w, h, d)
    box = np.array([-w / 2 + 0.25, 0.5, -d + 0.25]), np.array([w / 2 - 0.25, h - 0.4, -0.25])
    return _finish(b, name, kind, light, box, (1.8, 0.95 * d), (40, 80))


def _showroom(b: Composer, name: str, kind: str) -> Composition:
    """A high hall with a glossy floor: statues, vehicles, plants and people under strips and spots."""
    rng = b.rng
    w, h, d = rng.uniform((8, 3.5, 9), (14, 6, 16))
    light = _shell(b, w, h, d, glossy=True)
    low, high = (-w / 2 + 1, -d + 1), (w / 2 - 1, -1)
    b.scatter(int(rng.integers(1, 4)), low, high, "vehicle", longest=(0.7, 5.5))
    for _ in range(int(rng.integers(2, 6))):
        x, z = rng.uniform(low, high)
        if b.claim(x, z, 0.45, 0.45):
            height = rng.uniform(0.3, 1.1)
            stand = moved(meshes.box((0.35, height / 2, 0.35)), (x, height / 2, z))
            b.add("pedestal", stand, b.surface("stone", "wood", "plaster", roughness=(0.1, 0.8)))
            asset = b.choose("statue", "rock", "instrument", "electronics", "kitchen", "animal", "plant")
            b.put(asset, (x, height, z), rng.uniform(0, 360), claim=False, scale=rng.uniform(0.6, 1.0))
    b.scatter(int(rng.integers(1, 5)), low, high, "people", longest=(1.2, 2.1))
    b.scatter(int(rng.integers(4, 9)), low, high, "furniture", "plant", "outdoor", "thin", longest=(0.5, 3))
    for _ in range(int(rng.integers(3, 8))):
        _picture_on_wall(b, w, h, d)
    box = np.array([-w / 2 + 0.4, 0.6, -d + 0.4]), np.array([w / 2 - 0.4, h - 0.8, -0.4])
    return _finish(b, name, kind, light, box, (2.5, 0.85 * d), (35, 75))


def _table_top(b: Composer, name: str, kind: str) -> Composition:
    """Many small things on a slab before a backdrop, seen from near."""
    rng = b.rng
    half = rng.uniform((0.5, 0.35), (0.9, 0.6))
    slab = moved(meshes.box((half[0], 0.03, half[1])), (0, 0.72, -1))
    b.add("table", slab.scale_uv(rng.uniform(0.8, 2)), b.surface("wood", "stone", "tile", "metal", "fabric",
                                                                 roughness=(0.08, 0.8)))  # fmt: skip
    b.add("foot", moved(meshes.box((0.3 * half[0], 0.345, 0.3 * half[1])), (0, 0.345, -1)), plain(0.2))
    light = _shell(b, 4, 2.6, 4) if rng.uniform() < 0.6 else _open_air(b, "studio", "indoor")
    if not light.get("closed"):
        b.add("ground", _ground(8), b.surface("wood", "stone", "tile", "plaster"))
    low, high = np.array([-half[0], -1 - half[1]]) + 0.06, np.array([half[0], half[1] - 1]) - 0.06
    b.scatter(int(rng.integers(9, 22)), low, high, *SMALL, y=0.7505, longest=(0.04, 0.38))
    for _ in range(int(rng.integers(1, 3))):  # soft boxes
        x, y, z = rng.uniform((-1.3, 1.5, -1.6), (1.3, 2.3, -0.4))
        a = rng.uniform(0.1, 0.4)
        b.light(meshes.quad((x - a, y, z - a), (2 * a, 0, 0), (0, 0, 2 * a)), log_uniform(rng, 4, 40))
    box = np.array([-1.2, 0.85, -1.9]), np.array([1.2, 1.7, -0.1])
    return _finish(b, name, kind, light, box, (0.3, 1.1), (25, 55), passing=("toy", "kitchen", "food"))


def _street(b: Composer, name: str, kind: str) -> Composition:
    """A road along z with vehicles, pavements with people, trees and street furniture, houses on both sides."""
    rng = b.rng
    night = rng.uniform() < 0.2
    light = _open_air(b, "night" if night else "outdoor", sun=not night)
    road, pavement = rng.uniform(3.2, 4.5), rng.uniform(2, 3.5)  # half width; width
    strip = meshes.quad((-road, 0, 20), (2 * road, 0, 0), (0, 0, -90))
    b.add("road", strip.scale_uv(0.35), b.surface("ground", "stone", roughness=(0.25, 0.9), tint=True))
    b.add("land", moved(_ground(120), (0, -0.02, 0)), b.surface("grass", "ground"))
    stones = b.surface("tile", "stone", "brick", roughness=(0.3, 0.9))
    for side in (-1, 1):
        walk = meshes.box((pavement / 2, 0.06, 45))
        b.add("pavement", moved(walk, (side * (road + pavement / 2), 0.06, -25)).scale_uv(0.6), stones)
        _houses(b, side * (road + pavement), side, night)
        x = side * (road + pavement / 2)
        for categories, count, longest in ((("people",), 4, (1.2, 2.1)), (("plant",), 4, (1.0, 8.0)),
                                           (("outdoor", "thin", "lamp", "tools", "misc"), 5, (0.6, 2.8))):  # fmt: skip
            low, high = (x - pavement / 2 + 0.3, -32), (x + pavement / 2 - 0.3, 4)
            b.scatter(int(rng.integers(1, count + 1)), low, high, *categories, y=0.12, longest=longest)
        for z in -np.cumsum(rng.uniform(7, 14, 4)) + 6:
            vehicle = b.choose("vehicle", longest=(1.4, 9))
            b.put(vehicle, (side * road * rng.uniform(0.4, 0.65), 0, z), 0 if side < 0 else 180)
        if night:
            for z in -np.arange(4, 34, 9.0):
                bulb = moved(meshes.sphere(0.16), (side * (road + 0.4), 4.2, z))
                b.light(bulb, rng.uniform(60, 160))
                b.add("post", moved(meshes.cylinder(0.05, 2), (side * (road + 0.4), 2, z)), plain(0.1, 0.4, 1.0))
    box = np.array([-road - pavement + 0.4, 0.7, -30]), np.array([road + pavement - 0.4, 3.2, 6])
    return _finish(b, name, kind, light, box, (4, 16), (35, 70))


def _garden(b: Composer, name: str, kind: str) -> Composition:
    """Plants, trees and rocks on open ground, with furniture, animals and people between them."""
    rng = b.rng
    light = _open_air(b, "outdoor")
    b.add("ground", _ground(80).scale_uv(0.5), b.surface("grass", "ground", roughness=(0.7, 1.0)))
    low, high = (-6, -12), (6, 0)
    b.scatter(int(rng.integers(1, 4)), low, high, "outdoor", "thin", longest=(0.8, 4))
    b.scatter(int(rng.integers(2, 6)), low, high, "animal", "people", "rock", "statue", longest=(0.3, 2.2))
    b.scatter(int(rng.integers(16, 34)), low, high, "plant", longest=(0.25, 6))
    b.scatter(int(rng.integers(2, 6)), (-16, -24), (16, -13), "plant", "building", longest=(3, 14))
    for thing in [t for t in b.things if t.top and 0.3 < t.top < 1.2]:
        b.set_table(thing, int(rng.integers(2, 5)), *SMALL)
    if rng.uniform() < 0.3:
        fence = meshes.bars(12, 1.0, int(rng.integers(30, 70)), 0.03)
        b.add("fence", moved(fence, (0, 0.5, -12.5)), b.surface("wood", "metal", roughness=(0.2, 0.8)))
    box = np.array([-6.0, 0.35, -11.0]), np.array([6.0, 2.2, 1.5])
    return _finish(b, name, kind, light, box, (1.2, 7), (30, 65))


KINDS = {
    "room": (0.36, _room), "table top": (0.2, _table_top), "street": (0.18, _street), "garden": (0.14, _garden),
    "showroom": (0.12, _showroom),
}  # fmt: skip


# --- parts of places --------------------------------------------------------------------------------------------------


def _ground(side: float) -> meshes.Mesh:
    return meshes.quad((-side / 2, 0, side / 2), (side, 0, 0), (0, 0, -side))


def _open_air(b: Composer, *tags: str, sun: bool = True) -> dict:
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


def _shell(b: Composer, w: float, h: float, d: float, glossy: bool = False) -> dict:
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


def _against_wall(b: Composer, w: float, d: float) -> None:
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


def _picture_on_wall(b: Composer, w: float, h: float, d: float) -> None:
    width, height = b.rng.uniform(0.3, 1.0, 2)
    y, share = b.rng.uniform(0.5 * h, max(h - height - 0.2, 0.51 * h)), b.rng.uniform(0.15, 0.8)
    x = w / 2 - 0.015
    places = {
        "back": ((w * (share - 0.5), y, 0.015 - d), (width, 0, 0)),
        "left": ((-x, y, -d * share), (0, 0, -width)), "right": ((x, y, -d * share), (0, 0, width)),
    }  # fmt: skip
    corner, along = places[str(b.rng.choice(list(places)))]
    b.picture(corner, along, (0, height, 0))


def _houses(b: Composer, x: float, side: int, night: bool) -> None:
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


def _finish(
    b: Composer, name: str, kind: str, light: dict, box, reach, fov, passing=("toy", "misc", "electronics", "food")
) -> Composition:
    """Choose what can move, park what crosses the view, and add a glass thing in some."""
    rng = b.rng
    things = list(b.things)
    if rng.uniform() < 0.35 and things:
        base = things[int(rng.integers(len(things)))]
        radius = rng.uniform(0.1, 0.3) * min(base.size[[0, 2]].min(), 0.6)
        place = base.centre + np.array([base.size[0] / 2 + radius + 0.02, radius - base.size[1] / 2, 0])
        b.add("glass ball", moved(meshes.sphere(radius), place), glass())
    parked = []
    for k in range(3):
        asset = b.choose(*passing, longest=(0.05, 1.2))
        thing = b.put(asset, (10.0 * k, PARKED, 0), rng.uniform(0, 360), claim=False)
        parked += [thing] if thing else []
    order = [things[i] for i in rng.permutation(len(things))]
    movers = sorted(order, key=lambda thing: not thing.asset.tags & {"people", "vehicle", "animal", "toy"})[:MOVERS]
    pivots = {id: thing.centre for thing in (*movers, *parked) for id in thing.ids}
    objects = tuple(_movable(o, pivots) for o in b.objects)
    facts = {
        "kind": "composed", "place": kind, "assets": dict(sorted(b.used.items())), "skipped": b.skipped,
        "light": sorted(key for key in light if key in ("sky", "sun", "window")) + light.get("lamps", []),
    }  # fmt: skip
    parts = {key: light[key] for key in ("sky", "sun", "spots") if key in light}
    scene = Scene(name, objects, camera=None, facts=facts, **parts)  # `takes` gives it a camera
    return Composition(scene, tuple(things), tuple(movers), tuple(parked), *box, reach, fov)


def _movable(o: Object, pivots: dict[int, np.ndarray]) -> Object:
    return replace(o, motion=Motion(pivot=tuple(pivots[o.id].tolist()))) if o.id in pivots else o
