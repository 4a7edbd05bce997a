"""Sets for `render.py` of other kinds: bodies that bend, what falls, a street at night, lights that move."""

from __future__ import annotations

import math
import random

import bpy
from sets import ball, box, build, keyframe, material, plain_material, sky, sunlight


def build_walker(scene: bpy.types.Scene, frames: int) -> None:
    """The room of `sets`, and a body in a patterned cloth that bends and twists."""
    build(scene, frames)
    bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=0.22, depth=1.6, location=(0.1, -0.3, 0.8))
    body = bpy.context.object
    body.data.materials.append(material("cloth", (0.5, 0.1, 0.1), (0.9, 0.7, 0.3), 12))
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=6)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.object.shade_smooth()
    for method, axis, greatest, pace in (("BEND", "X", 0.6, 0.5), ("TWIST", "Z", 0.5, 0.4)):
        deform = body.modifiers.new(method.lower(), "SIMPLE_DEFORM")
        deform.deform_method, deform.deform_axis = method, axis
        for number in range(frames + 2):
            deform.angle = greatest * math.sin(pace * number)
            deform.keyframe_insert("angle", frame=number)


def build_flag(scene: bpy.types.Scene, frames: int) -> None:
    """A checked flag that flutters in the sun, before houses and a camera that stands still."""
    draw = random.Random(3)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=60, y_subdivisions=24, size=1, location=(-0.2, 0, 2.3))
    cloth = bpy.context.object
    cloth.rotation_euler, cloth.scale = (math.pi / 2, 0, 0), (3.0, 1.8, 1)
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)
    bpy.ops.object.shade_smooth()
    cloth.data.materials.append(material("cloth", (0.8, 0.05, 0.05), (0.9, 0.9, 0.9), 5))
    cloth.shape_key_add(name="flat")
    for name, wave in (("sine", math.sin), ("cosine", math.cos)):  # a wave that travels is a sum of two that stand
        shape = cloth.shape_key_add(name=name)
        shape.slider_min = -1
        for point in shape.data:
            x, y, _ = point.co
            point.co.z = 0.25 * (x / 3 + 0.5) * wave(7 / 3 * x + 0.8 * y)
        for number in range(frames + 2):
            shape.value = math.cos(1.1 * number) if name == "sine" else -math.sin(1.1 * number)
            shape.keyframe_insert("value", frame=number)
    bpy.ops.mesh.primitive_cylinder_add(radius=0.05, depth=5, location=(-1.75, 0, 1.5))
    bpy.context.object.data.materials.append(plain_material("pole", Metallic=1.0, Roughness=0.3))
    box("ground", (0, 20, -1.0), (80, 60, 0.1), material("earth", (0.3, 0.35, 0.15), (0.2, 0.25, 0.1), 0.5))
    for n in range(12):
        dark, light = ([draw.uniform(0.05, 0.8) for _ in range(3)] for _ in range(2))
        height, paint = draw.uniform(2, 5), material(f"house{n}", dark, light, 1.2)
        box(f"house{n}", (2.2 * n - 12, draw.uniform(12, 17), height / 2 - 1), (2, 2, height), paint)
    sunlight((0.8, 0.5, 0), 0.01)
    sky(scene, (0.5, 0.65, 0.95))
    bpy.ops.object.camera_add(location=(0, -4.5, 1.6), rotation=(math.radians(96), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 28


def build_snow(scene: bpy.types.Scene, frames: int) -> None:
    """Flakes that fall by 4 to 12 cm a frame between dark trunks, at dusk, before a camera that pans."""
    draw = random.Random(8)
    box("ground", (0, 6, -0.05), (20, 20, 0.1), plain_material("snow", Base_Color=(0.8, 0.82, 0.85, 1)))
    bark = material("bark", (0.05, 0.03, 0.02), (0.2, 0.13, 0.08), 6)
    for n in range(14):
        box(f"trunk{n}", (draw.uniform(-5, 5), draw.uniform(3, 9), 2), (0.25, 0.25, 4), bark)
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=1, radius=1)
    first = bpy.context.object
    first.data.materials.append(plain_material("flake", Base_Color=(0.9, 0.9, 0.9, 1)))
    for n in range(260):
        flake = bpy.data.objects.new(f"flake{n}", first.data)
        scene.collection.objects.link(flake)
        flake.scale = [draw.uniform(0.008, 0.02)] * 3
        x, y, z = draw.uniform(-3, 3), draw.uniform(-2, 4), draw.uniform(0, 4)
        way = draw.uniform(0.04, 0.12) * (frames - 1)
        keyframe(flake, frames, (x, y, z), (x + 0.3 * way, y, z - way))
    bpy.data.objects.remove(first)
    bpy.ops.object.light_add(type="POINT", location=(1.5, 1, 2.5))
    bpy.context.object.data.energy = 150
    sky(scene, (0.05, 0.07, 0.12))
    turning_camera(scene, (-0.3, -4, 1.4), 88, [0.01 * number - 0.04 for number in range(frames + 2)])


def build_night(scene: bpy.types.Scene, frames: int) -> None:
    """A wet alley, lit by small bulbs alone, with balls of glass: few samples find a light."""
    draw = random.Random(12)
    box("ground", (0, 4, -0.05), (8, 20, 0.1), plain_material("wet", Base_Color=(0.05, 0.05, 0.06, 1), Roughness=0.15))
    for side in (-2.6, 2.6):
        for n in range(5):
            dark, light = ([draw.uniform(0.05, 0.6) for _ in range(3)] for _ in range(2))
            box(f"house{side}{n}", (side, 3 * n - 2, 2), (1, 2.8, 4), material(f"house{side}{n}", dark, light, 5))
    for n in range(14):
        warm = 1, draw.uniform(0.5, 0.9), draw.uniform(0.2, 0.8), 1
        bulb = plain_material(f"bulb{n}", Emission_Color=warm, Emission_Strength=120.0)
        ball(f"bulb{n}", (draw.uniform(-1.8, 1.8), draw.uniform(0, 10), draw.uniform(2, 3)), 0.04, bulb)
    glass = plain_material("glass", Transmission_Weight=1.0, Roughness=0.02)
    for n in range(6):
        ball(f"glass{n}", (draw.uniform(-1.5, 1.5), draw.uniform(0, 6), 0.3), 0.3, glass)
    sky(scene, (0.002, 0.003, 0.006))
    bpy.ops.object.camera_add(rotation=(math.radians(86), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.1, -4, 1.4), (0.1, -3.5, 1.4))


def build_isometric(scene: bpy.types.Scene, frames: int) -> None:
    """Crates in the sun, some of which slide, before an orthographic camera that moves."""
    draw = random.Random(3)
    box("ground", (0, 0, -0.05), (30, 30, 0.1), material("earth", (0.25, 0.2, 0.15), (0.5, 0.45, 0.35), 1.5))
    for n in range(26):
        dark, light = ([draw.uniform(0.05, 0.9) for _ in range(3)] for _ in range(2))
        x, y, high = draw.uniform(-4, 4), draw.uniform(-4, 4), draw.uniform(0.3, 1.6)
        size = draw.uniform(0.4, 1), draw.uniform(0.4, 1), high
        crate = box(f"crate{n}", (x, y, high / 2), size, material(f"crate{n}", dark, light, 4))
        if n % 4 == 0:
            end = x + draw.uniform(-0.8, 0.8), y + draw.uniform(-0.8, 0.8), high / 2
            keyframe(crate, frames, (x, y, high / 2), end)
    sunlight((0.7, 0.4, 0), 0.02)
    sky(scene, (0.3, 0.4, 0.6))
    bpy.ops.object.camera_add(rotation=(math.radians(55), 0, math.radians(45)))
    scene.camera = bpy.context.object
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 7
    keyframe(scene.camera, frames, (10, -10, 10), (10.4, -9.7, 10))


def build_whip(scene: bpy.types.Scene, frames: int) -> None:
    """The room of `sets` before a camera that swings round, by a quarter of the picture a frame at most."""
    build(scene, frames)
    bpy.data.objects.remove(scene.camera)
    half = (frames + 1) / 2
    turning_camera(scene, (-0.2, -3.4, 1.5), 84, [-0.45 * math.tanh((n - half) / 1.5) for n in range(frames + 2)])


def turning_camera(scene: bpy.types.Scene, place: tuple, down: float, angles: list[float]) -> None:
    """A camera that turns about the vertical axis by the angle in radians of each frame, from frame 0 on. `down`: 90
    looks ahead, less looks down."""
    bpy.ops.object.camera_add(location=place)
    scene.camera = bpy.context.object
    for number, angle in enumerate(angles):
        scene.camera.rotation_euler = math.radians(down), 0, angle
        scene.camera.keyframe_insert("rotation_euler", frame=number)


def build_debris(scene: bpy.types.Scene, frames: int) -> None:
    """Two hundred chips of a wall that tumble through the sun, before a camera that shakes: little noise, and little
    that history knows."""
    draw = random.Random(8)
    box("ground", (0, 2, -0.05), (20, 20, 0.1), material("ground", (0.35, 0.3, 0.25), (0.2, 0.18, 0.15), 2.0))
    box("wall", (0, 6, 2), (16, 0.1, 4), material("wall", (0.5, 0.45, 0.4), (0.3, 0.25, 0.3), 1.2))
    looks = [material(f"chip {n}", (draw.uniform(0, 0.8), 0.4, 0.3), (0.7, draw.uniform(0, 0.6), 0.2), 6.0)
             for n in range(5)]  # fmt: skip
    for n in range(200):
        side = draw.uniform(0.04, 0.25)
        chip = box(f"chip {n}", (0, 0, 0), (side, side * draw.uniform(0.3, 1), side * 0.6), looks[n % 5])
        start = draw.gauss(0, 0.8), draw.gauss(2.5, 0.5), draw.gauss(1, 0.5)
        speed = draw.gauss(0, 0.14), draw.gauss(-0.03, 0.08), draw.gauss(0.12, 0.1)
        spin = [draw.gauss(0, 0.3) for _ in range(3)]
        for k in range(frames + 2):
            x, y, z = (a + k * b for a, b in zip(start, speed, strict=True))
            chip.location, chip.rotation_euler = (x, y, max(z - 0.012 * k * k, 0.05)), [k * a for a in spin]
            chip.keyframe_insert("location", frame=k)
            chip.keyframe_insert("rotation_euler", frame=k)
    sunlight((0.7, 0.5, 0), 0.02)
    sky(scene, (0.3, 0.4, 0.6))
    bpy.ops.object.camera_add()
    scene.camera = bpy.context.object
    scene.camera.data.lens = 30
    for k in range(frames + 2):
        scene.camera.location = draw.gauss(0, 0.03), -3, 1.5 + draw.gauss(0, 0.03)
        scene.camera.rotation_euler = math.radians(84) + draw.gauss(0, 0.006), 0, draw.gauss(0, 0.006)
        scene.camera.keyframe_insert("location", frame=k)
        scene.camera.keyframe_insert("rotation_euler", frame=k)


def build_tiles(scene: bpy.types.Scene, frames: int) -> None:
    """Glossy tiles to the horizon and posts in the sun, before a camera that runs forward near the ground."""
    draw = random.Random(1)
    tiles = plain_material("tiles", Roughness=0.15)
    nodes, links = tiles.node_tree.nodes, tiles.node_tree.links
    checks, coordinates = nodes.new("ShaderNodeTexChecker"), nodes.new("ShaderNodeTexCoord")
    checks.inputs["Scale"].default_value = 3
    for name, colour in (("Color1", (0.8, 0.8, 0.78, 1)), ("Color2", (0.03, 0.03, 0.04, 1))):
        checks.inputs[name].default_value = colour
    links.new(coordinates.outputs["Object"], checks.inputs["Vector"])
    links.new(checks.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    bpy.ops.mesh.primitive_plane_add(size=400)
    bpy.context.object.data.materials.append(tiles)
    for n in range(12):
        look = material(f"post{n}", *([draw.random() for _ in range(3)] for _ in range(2)), 3, 0.4)
        box(f"post{n}", (draw.uniform(-6, 6), draw.uniform(2, 20), 0.5), (0.5, 0.5, draw.uniform(1, 3)), look)
    rolls = ball("ball", (0, 0, 0), 0.4, material("ball", (0.9, 0.2, 0.1), (0.95, 0.9, 0.8), 4, 0.2))
    keyframe(rolls, frames, (-1.5, 2, 0.4), (1.5, 3, 0.4))
    sunlight((0.9, 0.4, 0), 0.02)
    sky(scene, (0.5, 0.65, 0.9))
    bpy.ops.object.camera_add(rotation=(math.radians(86), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 26
    keyframe(scene.camera, frames, (0, -3, 0.8), (0.1, -1, 0.8))


def build_lantern(scene: bpy.types.Scene, frames: int) -> None:
    """A lantern that is carried past columns, and is the only light: all shadows swing."""
    plaster = material("plaster", (0.75, 0.72, 0.68), (0.65, 0.6, 0.58), 2)
    box("floor", (0, 0, -0.05), (6, 6, 0.1), material("floor", (0.35, 0.2, 0.1), (0.55, 0.35, 0.2), 3, 0.5))
    box("ceiling", (0, 0, 3.05), (6, 6, 0.1), plaster)
    box("back", (0, 3.05, 1.5), (6, 0.1, 3), plaster)
    for side in (-1, 1):
        box(f"wall{side}", (3.05 * side, 0, 1.5), (0.1, 6, 3), plaster)
    for n in range(5):
        box(f"column{n}", (n - 2, 1.3, 1.2), (0.18, 0.18, 2.4), plaster)
    for n in range(4):
        look = material(f"crate{n}", (0.2 + 0.15 * n, 0.3, 0.5 - 0.1 * n), (0.6, 0.6, 0.3), 4)
        box(f"crate{n}", (1.1 * n - 1.6, 2.1, 0.3), (0.5, 0.4, 0.6), look)
    bpy.ops.object.light_add(type="POINT")
    lamp = bpy.context.object
    lamp.data.energy, lamp.data.shadow_soft_size, lamp.data.color = 45, 0.05, (1, 0.8, 0.55)
    keyframe(lamp, frames, (-1.3, 0.3, 1.1), (0.16 * (frames - 1) - 1.3, 0.3, 1.1))
    bpy.ops.object.camera_add(location=(0, -3.2, 1.5), rotation=(math.radians(86), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 26


VARIETY_SETS = {
    "walker": build_walker, "flag": build_flag, "snow": build_snow, "night": build_night,
    "isometric": build_isometric, "whip": build_whip, "debris": build_debris, "tiles": build_tiles,
    "lantern": build_lantern,
}  # fmt: skip
