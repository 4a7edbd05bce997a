"""Sets for `render.py --surfaces` in which things move so fast that motion blur shows."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import bpy
from sets import ball, box, build, keyframe, material, plain_material, sky, sunlight


def build_drive(scene: bpy.types.Scene, frames: int) -> None:
    """A car drives past houses and posts, by 25 pixels a frame. The camera follows more slowly."""
    draw = random.Random(11)

    def colours() -> list[list[float]]:
        return [[draw.uniform(0.1, 0.9) for _ in range(3)] for _ in range(2)]

    box("road", (0, 6, -0.05), (60, 24, 0.1), material("road", (0.1, 0.1, 0.11), (0.22, 0.2, 0.2), 2.0))
    for n in range(10):
        look, height = material(f"house {n}", *colours(), 1.6), draw.uniform(2.5, 5)
        box(f"house {n}", (3.0 * n - 14, 9 + draw.uniform(-0.5, 1.5), height / 2), (2.6, 2, height), look)
    for n in range(9):
        stripes = material(f"post {n}", (0.8, 0.8, 0.8), (0.5, 0.1, 0.1), 6.0)
        box(f"post {n}", (2.0 * n - 8, 4.6, 0.6), (0.12, 0.12, 1.2), stripes)
    paint = plain_material("paint", Base_Color=(0.6, 0.05, 0.03, 1), Roughness=0.25, Metallic=0.3)
    car = box("car", (0, 0, 0), (2.2, 1.0, 0.5), paint)
    dark = plain_material("windows", Base_Color=(0.05, 0.06, 0.08, 1), Roughness=0.1)
    box("cabin", (-0.1, 0, 0.45), (1.2, 0.9, 0.4), dark).parent = car
    for n, (x, y) in enumerate(((-0.7, -0.52), (0.7, -0.52), (-0.7, 0.52), (0.7, 0.52))):
        bpy.ops.mesh.primitive_cylinder_add(radius=0.28, depth=0.15, location=(x, y, -0.25))
        wheel = bpy.context.object
        wheel.data.materials.append(material(f"wheel {n}", (0.02, 0.02, 0.02), (0.5, 0.5, 0.5), 5.0))
        wheel.parent = car
        turn(wheel, frames, lambda k: (math.pi / 2, 1.2 * k, 0))
    keyframe(car, frames, (-2.2, 3.2, 0.55), (0.38 * (frames - 1) - 2.2, 3.2, 0.55))
    sunlight((0.6, 0.5, 0), 0.03)
    sky(scene, (0.35, 0.45, 0.6))
    bpy.ops.object.camera_add(rotation=(math.radians(86), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 40
    keyframe(scene.camera, frames, (-1.4, -3, 1.6), (0.2 * (frames - 1) - 1.4, -3, 1.6))


def build_fan(scene: bpy.types.Scene, frames: int) -> None:
    """A fan that turns by 25° a frame before a wall. The camera stands still."""
    box("wall", (0, 3, 1.5), (8, 0.1, 4), material("wall", (0.7, 0.65, 0.5), (0.25, 0.35, 0.5), 1.5))
    box("floor", (0, 1, -0.05), (8, 8, 0.1), material("floor", (0.3, 0.2, 0.1), (0.6, 0.5, 0.4), 2.0))
    hub = ball("hub", (0, 0, 1.4), 0.15, material("hub", (0.1, 0.1, 0.1), (0.3, 0.3, 0.3), 5.0))
    for n in range(4):
        size = (0.9, 0.05, 0.25) if n % 2 else (0.25, 0.05, 0.9)
        paint = material(f"blade {n}", (0.7, 0.2, 0.1), (0.9, 0.8, 0.3), 4.0)
        place = 0.6 * math.sin(n * math.pi / 2), 0, 0.6 * math.cos(n * math.pi / 2)
        box(f"blade {n}", place, size, paint).parent = hub
    turn(hub, frames, lambda k: (0, math.radians(25) * k, 0))
    bpy.ops.object.light_add(type="AREA", location=(2, -2, 3.5), rotation=(math.radians(40), math.radians(30), 0))
    lamp = bpy.context.object.data
    lamp.energy, lamp.size = 200, 0.6
    sky(scene, (0.2, 0.22, 0.28))
    bpy.ops.object.camera_add(location=(0, -3.2, 1.4), rotation=(math.radians(90), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 40


def build_pan(scene: bpy.types.Scene, frames: int) -> None:
    """The room of `sets`, before a camera that turns by 24° from the first frame to the last."""
    build(scene, frames)
    camera = scene.camera
    x, y, z = camera.rotation_euler
    turn(camera, frames, lambda k: (x, y, z + math.radians(24 * k / (frames + 1) - 12)))


def turn(item: bpy.types.Object, frames: int, angles: Callable[[int], tuple[float, float, float]]) -> None:
    """Turn to `angles(k)`, radians about each axis, in frame k: from one before the first to one after the last."""
    for k in (0, frames + 1):
        item.rotation_euler = angles(k)
        item.keyframe_insert("rotation_euler", frame=k)


MOTION_SETS = {"drive": build_drive, "fan": build_fan, "pan": build_pan}
