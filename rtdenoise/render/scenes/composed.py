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
from .placing import Composer, Thing, glass, plain
from .procedural import log_uniform, moved
from .scene import Object, Scene
from .surroundings import against_wall, ground, houses, open_air, picture_on_wall, shell

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
    light = shell(b, w, h, d)
    table = b.put(b.choose("furniture", longest=(0.9, 2.4), word="table"), (rng.uniform(-0.5, 0.5), 0, -d / 2), 0)
    for angle in rng.uniform(0, 90) + np.arange(0, 360, 90) if table else ():
        away = np.radians(angle)
        out = np.hypot(*(table.size[[0, 2]] * (np.sin(away), np.cos(away)))) / 2 + 0.4
        place = table.centre * (1, 0, 1) + out * np.array([np.sin(away), 0, np.cos(away)])
        b.put(b.choose("furniture", word="chair"), place, angle + 180 + rng.uniform(-12, 12), margin=0)
    for _ in range(int(rng.integers(5, 10))):
        against_wall(b, w, d)
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
        picture_on_wall(b, w, h, d)
    box = np.array([-w / 2 + 0.25, 0.5, -d + 0.25]), np.array([w / 2 - 0.25, h - 0.4, -0.25])
    return _finish(b, name, kind, light, box, (1.8, 0.95 * d), (40, 80))


def _showroom(b: Composer, name: str, kind: str) -> Composition:
    """A high hall with a glossy floor: statues, vehicles, plants and people under strips and spots."""
    rng = b.rng
    w, h, d = rng.uniform((8, 3.5, 9), (14, 6, 16))
    light = shell(b, w, h, d, glossy=True)
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
        picture_on_wall(b, w, h, d)
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
    light = shell(b, 4, 2.6, 4) if rng.uniform() < 0.6 else open_air(b, "studio", "indoor")
    if not light.get("closed"):
        b.add("ground", ground(8), b.surface("wood", "stone", "tile", "plaster"))
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
    light = open_air(b, "night" if night else "outdoor", sun=not night)
    road, pavement = rng.uniform(3.2, 4.5), rng.uniform(2, 3.5)  # half width; width
    strip = meshes.quad((-road, 0, 20), (2 * road, 0, 0), (0, 0, -90))
    b.add("road", strip.scale_uv(0.35), b.surface("ground", "stone", roughness=(0.25, 0.9), tint=True))
    b.add("land", moved(ground(120), (0, -0.02, 0)), b.surface("grass", "ground"))
    stones = b.surface("tile", "stone", "brick", roughness=(0.3, 0.9))
    for side in (-1, 1):
        walk = meshes.box((pavement / 2, 0.06, 45))
        b.add("pavement", moved(walk, (side * (road + pavement / 2), 0.06, -25)).scale_uv(0.6), stones)
        houses(b, side * (road + pavement), side, night)
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
    light = open_air(b, "outdoor")
    b.add("ground", ground(80).scale_uv(0.5), b.surface("grass", "ground", roughness=(0.7, 1.0)))
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
    order = [things[i] for i in rng.permutation(len(things)) if not things[i].top]  # things stand on flat tops
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
