"""Scenes for `render.py`, as those of `sets`, for lenses: depth of field, panoramas, zooms."""

from __future__ import annotations

import math
import random

import bpy
from sets import ball, box, build, keyframe, material, plain_material, sky


def focus(camera: bpy.types.Object, distance: float, f_stop: float) -> None:
    """Sharp at `distance` metres; the lens is as wide as makes the blur of a large picture visible in a small one."""
    lens = camera.data.dof
    lens.use_dof, lens.focus_distance, lens.aperture_fstop = True, distance, f_stop


def build_portrait(scene: bpy.types.Scene, frames: int) -> None:
    """A monkey in focus before crates and small bright lamps that are not. The camera moves sideways."""
    draw = random.Random(4)
    tiles = material("tiles", (0.15, 0.12, 0.1), (0.7, 0.6, 0.5), 2.0, roughness=0.4)
    box("floor", (0, 4, -0.05), (14, 16, 0.1), tiles)
    box("back", (0, 9, 2), (14, 0.1, 4), material("paper", (0.3, 0.5, 0.4), (0.8, 0.75, 0.6), 2.5))
    for number in range(14):
        colours = [[draw.uniform(0.05, 0.9) for _ in range(3)] for _ in range(2)]
        height, look = draw.uniform(0.5, 2.2), material(f"crate {number}", *colours, 4.0)
        box(f"crate {number}", (draw.uniform(-4, 4), draw.uniform(3, 8), height / 2), (0.6, 0.6, height), look)
    for number in range(8):
        glow = plain_material(f"glow {number}", Base_Color=(0, 0, 0, 1), Emission_Strength=40.0)
        colour = draw.uniform(0.5, 1), draw.uniform(0.4, 0.8), draw.uniform(0.2, 0.6), 1
        glow.node_tree.nodes["Principled BSDF"].inputs["Emission Color"].default_value = colour
        ball(f"lamp {number}", (draw.uniform(-3.5, 3.5), draw.uniform(5, 8), draw.uniform(1.8, 3)), 0.06, glow)
    turn = math.radians(-8), 0, 0.3
    bpy.ops.mesh.primitive_monkey_add(size=1.1, location=(0.1, 0, 1.45), rotation=turn)
    bpy.ops.object.shade_smooth()
    monkey = bpy.context.object
    monkey.data.materials.append(material("fur", (0.55, 0.22, 0.08), (0.30, 0.10, 0.05), 4.0, 0.5))
    bpy.ops.object.light_add(type="AREA", location=(2.0, -1.5, 3.4))
    key = bpy.context.object
    key.data.energy, key.data.size = 220, 0.8
    key.rotation_euler = (key.location - monkey.location).to_track_quat("Z", "Y").to_euler()
    bpy.ops.object.light_add(type="AREA", location=(-1, 5, 3.8))
    bpy.context.object.data.energy, bpy.context.object.data.size = 300, 2
    sky(scene, (0.08, 0.1, 0.16))
    bpy.ops.object.camera_add(rotation=(math.radians(89), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 50
    focus(scene.camera, 2.4, 0.6)
    keyframe(scene.camera, frames, (-0.15, -2.6, 1.45), (-0.15 + 0.03 * (frames - 1), -2.6, 1.45))


def build_focus_pull(scene: bpy.types.Scene, frames: int) -> None:
    """`build_portrait`, whose focus goes from the monkey to the wall."""
    build_portrait(scene, frames)
    lens = scene.camera.data.dof
    for number in (0, frames + 1):
        lens.focus_distance = 2.4 + 5.0 * number / (frames + 1)
        lens.keyframe_insert("focus_distance", frame=number)


def build_macro(scene: bpy.types.Scene, frames: int) -> None:
    """Balls of metal and plastic on a table, seen from near by a camera that stands still. One of them rolls."""
    draw = random.Random(8)
    box("table", (0, 0, -0.05), (4, 6, 0.1), material("wood", (0.25, 0.12, 0.05), (0.5, 0.3, 0.15), 6.0, 0.4))
    for number in range(22):
        colours = [[draw.uniform(0.05, 0.9) for _ in range(3)] for _ in range(2)]
        if number % 3:
            look = material(f"ball {number}", *colours, 8.0, draw.uniform(0.2, 0.8))
        else:
            look = plain_material(f"ball {number}", Metallic=1.0, Roughness=0.2, Base_Color=(*colours[0], 1))
        radius = draw.uniform(0.06, 0.16)
        ball(f"ball {number}", (draw.uniform(-1, 1), draw.uniform(-1.0, 2.4), radius), radius, look)
    rolling = ball("rolling", (0, 0, 0), 0.12, material("red", (0.8, 0.1, 0.1), (0.9, 0.8, 0.7), 8.0))
    keyframe(rolling, frames, (-0.4, 0.1, 0.12), (-0.4 + 0.05 * (frames - 1), 0.1, 0.12))
    turn = math.radians(-20), math.radians(30), 0
    bpy.ops.object.light_add(type="AREA", location=(1.5, 1.0, 2.5), rotation=turn)
    bpy.context.object.data.energy, bpy.context.object.data.size = 80, 0.5
    sky(scene, (0.35, 0.42, 0.55))
    bpy.ops.object.camera_add(location=(0, -1.9, 0.6), rotation=(math.radians(76), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 60
    focus(scene.camera, 2.0, 0.5)


def build_panorama(scene: bpy.types.Scene, frames: int) -> None:
    """A courtyard all around a camera that walks through it, as an equirectangular panorama. Its left and right edges
    meet behind the camera, where a ball passes. Render it twice as wide as high."""
    draw = random.Random(12)
    box("ground", (0, 0, -0.05), (12, 12, 0.1), material("tiles", (0.2, 0.18, 0.16), (0.6, 0.55, 0.5), 1.5))
    for number, (x, y) in enumerate(((6, 0), (-6, 0), (0, 6), (0, -6))):
        colours = [[draw.uniform(0.2, 0.9) for _ in range(3)] for _ in range(2)]
        size = (0.2, 12, 4) if x else (12, 0.2, 4)
        box(f"wall {number}", (x, y, 2), size, material(f"wall {number}", *colours, 2.0))
    for number in range(16):
        turn, far, height = number * math.tau / 16, draw.uniform(2.2, 5.0), draw.uniform(0.4, 2.6)
        colours = [[draw.uniform(0.05, 0.9) for _ in range(3)] for _ in range(2)]
        place = far * math.cos(turn), far * math.sin(turn), height / 2
        box(f"post {number}", place, (0.5, 0.5, height), material(f"post {number}", *colours, 4.0))
    passing = ball("passing", (0, 0, 0), 0.35, material("red", (0.8, 0.1, 0.1), (0.9, 0.8, 0.7), 8.0))
    keyframe(passing, frames, (-0.6, -1.8, 1.2), (-0.6 + 0.08 * (frames - 1), -1.8, 1.2))
    bpy.ops.object.light_add(type="AREA", location=(2.5, 1.5, 3.8))
    bpy.context.object.data.energy, bpy.context.object.data.size = 200, 0.5
    sky(scene, (0.25, 0.32, 0.45))
    bpy.ops.object.camera_add(rotation=(math.radians(90), 0, 0))
    scene.camera = bpy.context.object
    scene.render.engine = "CYCLES"  # its cameras have the panorama's kind
    scene.camera.data.type, scene.camera.data.panorama_type = "PANO", "EQUIRECTANGULAR"
    keyframe(scene.camera, frames, (0, 0, 1.5), (0.03 * (frames - 1), 0.02 * (frames - 1), 1.5))


def build_vertigo(scene: bpy.types.Scene, frames: int) -> None:
    """The room of `sets`, before a camera that goes back while its lens gets longer."""
    build(scene, frames)
    camera = scene.camera
    camera.animation_data_clear()
    camera.rotation_euler = math.radians(86), 0, 0
    for number in range(frames + 2):
        way = 2.2 + 0.35 * number
        camera.location, camera.data.lens = (0, 1.2 - way, 1.4), 16 * way / 2.2
        camera.keyframe_insert("location", frame=number)
        camera.data.keyframe_insert("lens", frame=number)


LENS_SETS = {
    "portrait": build_portrait, "focus-pull": build_focus_pull, "macro": build_macro, "panorama": build_panorama,
    "vertigo": build_vertigo,
}  # fmt: skip
