"""Scenes of primitives for `render.py`: each function builds one, animated over so many frames, into an empty scene."""

from __future__ import annotations

import math
import random

import bpy
from mathutils import Vector


def material(name: str, dark: tuple, light: tuple, scale: float, roughness: float = 0.9) -> bpy.types.Material:
    """Two colours in a Voronoi pattern, in object space."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    coordinates, pattern = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeTexVoronoi")
    ramp, surface = nodes.new("ShaderNodeValToRGB"), nodes["Principled BSDF"]
    pattern.inputs["Scale"].default_value = scale
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (*dark, 1), (*light, 1)
    surface.inputs["Roughness"].default_value = roughness
    links.new(coordinates.outputs["Object"], pattern.inputs["Vector"])
    links.new(pattern.outputs["Distance"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], surface.inputs["Base Color"])
    return made


def box(name: str, location: tuple, size: tuple, look: bpy.types.Material) -> bpy.types.Object:
    """A box of `size` metres; the pattern keeps its scale."""
    bpy.ops.mesh.primitive_cube_add(size=1, location=location)
    made = bpy.context.object
    made.name, made.scale = name, size
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)
    made.data.materials.append(look)
    return made


def ball(name: str, location: tuple, radius: float, look: bpy.types.Material) -> bpy.types.Object:
    bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=location, segments=48, ring_count=24)
    made = bpy.context.object
    made.name = name
    bpy.ops.object.shade_smooth()
    made.data.materials.append(look)
    return made


def keyframe(item: bpy.types.Object, last: int, start: tuple, end: tuple) -> None:
    """Move at constant speed from `start` in frame 1 to `end` in frame `last`, and one frame beyond either: motion
    vectors need these frames."""
    for number in (0, last + 1):
        t = (number - 1) / max(last - 1, 1)
        item.location = [a + t * (b - a) for a, b in zip(start, end, strict=True)]
        item.keyframe_insert("location", frame=number)


def lamp_and_sky(scene: bpy.types.Scene) -> None:
    """A lamp above, to the right, and a sky of one colour."""
    bpy.ops.object.light_add(type="AREA", location=(2.5, -2.0, 4.0), rotation=(math.radians(35), math.radians(25), 0))
    bpy.context.object.data.energy, bpy.context.object.data.size = 350, 1.0
    sky(scene, (0.35, 0.50, 0.75))


def sky(scene: bpy.types.Scene, colour: tuple) -> None:
    """Light of one colour from everywhere."""
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (*colour, 1)


def sunlight(rotation: tuple, angle: float) -> None:
    """White light from far away; `angle` in radians is how wide the sun is."""
    bpy.ops.object.light_add(type="SUN", rotation=rotation)
    sun = bpy.context.object.data
    sun.energy, sun.angle = 3, angle


def build(scene: bpy.types.Scene, frames: int) -> None:
    """A room of 6 × 5 × 3 m, lit by a small lamp, and by the sky through the open side behind the camera."""
    plaster = material("plaster", (0.75, 0.68, 0.55), (0.25, 0.30, 0.45), 2.5)
    tiles = material("tiles", (0.15, 0.12, 0.10), (0.70, 0.60, 0.50), 2.0, roughness=0.4)
    red = material("red", (0.80, 0.12, 0.08), (0.60, 0.30, 0.10), 3.0)
    green = material("green", (0.10, 0.45, 0.15), (0.35, 0.70, 0.25), 4.0)
    blue = material("blue", (0.10, 0.20, 0.70), (0.50, 0.60, 0.85), 5.0, roughness=0.3)
    box("floor", (0, 0, -0.05), (6, 5, 0.1), tiles)
    box("ceiling", (0, 0, 3.05), (6, 5, 0.1), plaster)
    box("back", (0, 2.55, 1.5), (6, 0.1, 3), plaster)
    box("left", (-3.05, 0, 1.5), (0.1, 5, 3), red)
    box("right", (3.05, 0, 1.5), (0.1, 5, 3), green)
    box("crate", (1.6, 1.2, 0.5), (1, 1, 1), green)
    ball("globe", (-1.6, 1.4, 0.7), 0.7, plaster)
    post = box("post", (0, 0, 0), (0.5, 0.3, 1.8), red)
    hopper = ball("hopper", (0, 0, 0), 0.35, blue)
    reach = 0.12 * (frames - 1)
    keyframe(post, frames, (-0.9, 0.6, 0.9), (-0.9 + reach, 0.6, 0.9))
    keyframe(hopper, frames, (0.9, 0.2, 0.5), (0.9 - 0.3 * reach, 0.2, 0.5 + 0.5 * reach))

    bpy.ops.object.light_add(type="AREA", location=(0.8, 0.3, 2.9))
    bpy.context.object.data.energy, bpy.context.object.data.size = 90, 0.6
    sky(scene, (0.10, 0.13, 0.20))

    bpy.ops.object.camera_add(location=(0, 0, 0), rotation=(math.radians(84), 0, math.radians(2)))
    scene.camera = bpy.context.object
    scene.camera.data.angle = math.radians(62)
    keyframe(scene.camera, frames, (-0.2, -3.4, 1.5), (-0.2 + 0.25 * reach, -3.4, 1.5 + 0.2 * reach))


def plain_material(name: str, **inputs) -> bpy.types.Material:
    """Blender's Principled surface with some of its inputs set, by name ("_" for a space)."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    for key, value in inputs.items():
        made.node_tree.nodes["Principled BSDF"].inputs[key.replace("_", " ")].default_value = value
    return made


def build_still_life(scene: bpy.types.Scene, frames: int) -> None:
    """A monkey, a mirror ball that rolls past it and a glass ball on a chequered board, before a sky of one colour."""
    board = material("board", (0.08, 0.10, 0.14), (0.70, 0.65, 0.55), 1.5, roughness=0.6)
    box("board", (0, 0.5, -0.05), (5, 4, 0.1), board)
    bpy.ops.mesh.primitive_monkey_add(size=1.6, location=(-0.5, 1.0, 0.85), rotation=(math.radians(-12), 0, 0.35))
    bpy.ops.object.shade_smooth()
    bpy.context.object.data.materials.append(material("fur", (0.55, 0.22, 0.08), (0.30, 0.10, 0.05), 4.0, 0.5))
    mirror = plain_material("mirror", Metallic=1.0, Roughness=0.0, Base_Color=(0.9, 0.9, 0.92, 1))
    rolling = ball("mirror ball", (0, 0, 0), 0.45, mirror)
    clear = plain_material("glass", Transmission_Weight=1.0, Roughness=0.0, Base_Color=(1, 1, 1, 1))
    ball("glass ball", (1.3, 0.3, 0.5), 0.5, clear)
    reach = 0.1 * (frames - 1)
    keyframe(rolling, frames, (-1.5, -0.3, 0.45), (-1.5 + reach, -0.3, 0.45))

    lamp_and_sky(scene)
    bpy.ops.object.camera_add(rotation=(math.radians(82), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.angle = math.radians(50)
    keyframe(scene.camera, frames, (-0.2, -4.6, 1.5), (-0.2 + 0.3 * reach, -4.6, 1.5))


def build_turntable(scene: bpy.types.Scene, frames: int) -> None:
    """A monkey of brushed metal that turns by 6° a frame before nothing, in the light of two lamps."""
    metal = plain_material("metal", Metallic=0.9, Roughness=0.25, Base_Color=(0.8, 0.7, 0.6, 1))
    bpy.ops.mesh.primitive_monkey_add(size=1, location=(0, 0, 1))
    monkey = bpy.context.object
    bpy.ops.object.shade_smooth()
    monkey.data.materials.append(metal)
    for number in (0, frames + 1):
        monkey.rotation_euler = (0, 0, math.radians(6 * number))
        monkey.keyframe_insert("rotation_euler", frame=number)
    for location, colour, energy in (((3, -3, 4), (1, 0.8, 0.6), 300), ((-4, -2, 2), (0.4, 0.6, 1), 80)):
        bpy.ops.object.light_add(type="AREA", location=location)
        lamp = bpy.context.object
        lamp.data.energy, lamp.data.size, lamp.data.color = energy, 0.4, colour
        lamp.rotation_euler = (lamp.location - monkey.location).to_track_quat("Z", "Y").to_euler()
    bpy.ops.object.camera_add(location=(0, -3.2, 1.1), rotation=(math.radians(88), 0, 0))
    scene.camera = bpy.context.object


def build_meadow(scene: bpy.types.Scene, frames: int) -> None:
    """A monkey that flies over grass, whose blades are narrower than a pixel."""
    draw = random.Random(3)
    earth = plain_material("earth", Base_Color=(0.3, 0.32, 0.28, 1), Roughness=0.8)
    box("ground", (0, 5, -0.05), (30, 30, 0.1), earth)
    bpy.ops.mesh.primitive_cone_add(radius1=0.02, depth=0.35, vertices=4, location=(0, 0, -9))
    blade = bpy.context.object.data
    blade.materials.append(plain_material("leaf", Base_Color=(0.12, 0.4, 0.06, 1), Roughness=0.6))
    for number in range(4000):
        leaf = bpy.data.objects.new(f"leaf {number}", blade)
        leaf.location = draw.uniform(-3, 3), draw.uniform(-4, 5), 0.15
        leaf.rotation_euler = draw.uniform(-0.4, 0.4), draw.uniform(-0.4, 0.4), draw.uniform(0, 6)
        scene.collection.objects.link(leaf)
    bpy.ops.mesh.primitive_monkey_add(size=1.2)
    bpy.ops.object.shade_smooth()
    monkey, reach = bpy.context.object, 0.1 * (frames - 1)
    monkey.data.materials.append(plain_material("fur", Base_Color=(0.8, 0.3, 0.1, 1), Roughness=0.4))
    keyframe(monkey, frames, (0, 0, 1), (reach, 0, 1))

    bpy.ops.object.light_add(type="AREA", location=(3, -3, 4), rotation=(math.radians(54), 0, math.radians(45)))
    bpy.context.object.data.energy, bpy.context.object.data.size = 600, 0.5
    sky(scene, (0.15, 0.18, 0.25))
    bpy.ops.object.camera_add(rotation=(math.radians(84), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (0, -5, 1.6), (0.5 * reach, -5 + 0.2 * reach, 1.6))


def build_flicker(scene: bpy.types.Scene, frames: int) -> None:
    """Crates in a dark room, lit by a screen whose colour changes every two frames. Half way a lamp goes on."""
    draw = random.Random(3)
    plaster = plain_material("plaster", Base_Color=(0.75, 0.72, 0.65, 1), Roughness=0.8)
    green = plain_material("green", Base_Color=(0.15, 0.45, 0.2, 1), Roughness=0.8)
    box("floor", (0, 0, -0.05), (6, 6, 0.1), material("tiles", (0.15, 0.12, 0.1), (0.7, 0.6, 0.5), 2.0, roughness=0.4))
    box("ceiling", (0, 0, 3.05), (6, 6, 0.1), plaster)
    for name, x, y, size in (("back", 0, 3.05, (6, 0.1, 3)), ("front", 0, -3.05, (6, 0.1, 3)),
                             ("left", -3.05, 0, (0.1, 6, 3))):  # fmt: skip
        box(name, (x, y, 1.5), size, plaster)
    box("right", (3.05, 0, 1.5), (0.1, 6, 3), green)
    for number in range(6):
        look = plain_material(f"crate {number}", Base_Color=(*(draw.uniform(0.2, 0.8) for _ in range(3)), 1))
        box(f"crate {number}", (draw.uniform(-2, 2), draw.uniform(-1, 2), 0.3), (0.5, 0.5, 0.6), look)
    glow = plain_material("glow", Base_Color=(0, 0, 0, 1), Emission_Strength=4.0)
    box("screen", (0, 2.9, 1.5), (2.4, 0.05, 1.3), glow)
    bpy.ops.object.light_add(type="POINT", location=(2.2, 0, 2.2))
    lamp = bpy.context.object.data
    lamp.shadow_soft_size = 0.15
    colour = glow.node_tree.nodes["Principled BSDF"].inputs["Emission Color"]
    for number in range(frames + 2):
        if number % 2 == 0:
            shown = [draw.uniform(0, 1) for _ in range(3)]
        colour.default_value = *shown, 1
        colour.keyframe_insert("default_value", frame=number)
        lamp.energy = 80 if number > frames // 2 else 0
        lamp.keyframe_insert("energy", frame=number)
    bpy.ops.object.camera_add(rotation=(math.radians(80), 0, math.radians(-26)))
    scene.camera = bpy.context.object
    scene.camera.data.angle = math.radians(73)
    keyframe(scene.camera, frames, (-1.5, -2.6, 1.6), (-1.5 + 0.03 * (frames - 1), -2.6, 1.6))


def build_evening(scene: bpy.types.Scene, frames: int) -> None:
    """Houses on a plane, before a camera that stands still. The sun wanders around them, by 13° a frame."""
    draw = random.Random(5)
    box("ground", (0, 0, -0.05), (60, 60, 0.1), material("ground", (0.25, 0.2, 0.18), (0.7, 0.6, 0.5), 0.5))
    for number in range(40):
        look = plain_material(f"house {number}", Base_Color=(*(draw.uniform(0.2, 0.8) for _ in range(3)), 1))
        place = draw.uniform(-12, 12), draw.uniform(-4, 20), 0
        house = box(f"house {number}", place, (draw.uniform(1, 2), draw.uniform(1, 2), draw.uniform(2, 8)), look)
        house.rotation_euler = (0, 0, draw.uniform(0, 1.5))
    bpy.ops.object.light_add(type="SUN")
    sun = bpy.context.object
    sun.data.energy, sun.data.color, sun.data.angle = 4, (1, 0.85, 0.65), 0.01
    for number in (0, frames + 1):
        sun.rotation_euler = (math.radians(60), 0, math.radians(-70 + 13 * number))
        sun.keyframe_insert("rotation_euler", frame=number)
    sky(scene, (0.15, 0.22, 0.40))
    bpy.ops.object.camera_add(location=(0, -14, 9), rotation=(math.radians(63), 0, 0))
    scene.camera = bpy.context.object


def build_zoom(scene: bpy.types.Scene, frames: int) -> None:
    """Crates of two colours in a room, before a camera whose focal length grows by 4 to 9 % a frame."""
    draw = random.Random(5)
    plaster = plain_material("plaster", Base_Color=(0.75, 0.72, 0.65, 1), Roughness=0.8)
    box("floor", (0, 0, -0.05), (8, 8, 0.1), material("tiles", (0.15, 0.12, 0.1), (0.7, 0.6, 0.5), 2.0, roughness=0.4))
    box("ceiling", (0, 0, 4.05), (8, 8, 0.1), plaster)
    for name, x, y, size in (("back", 0, 4.05, (8, 0.1, 4)), ("left", -4.05, 0, (0.1, 8, 4)),
                             ("right", 4.05, 0, (0.1, 8, 4))):  # fmt: skip
        box(name, (x, y, 2), size, plaster)
    for number in range(14):
        colours = [[draw.uniform(0.1, 0.8) for _ in range(3)] for _ in range(2)]
        place = draw.uniform(-3, 3), draw.uniform(-1, 3), 0.5
        box(f"crate {number}", place, (0.6, 0.6, 1), material(f"crate {number}", *colours, 4.0))
    bpy.ops.object.light_add(type="AREA", location=(2, -2, 3.9), rotation=(math.radians(40), 0, math.radians(35)))
    bpy.context.object.data.energy = 200
    bpy.ops.object.camera_add(location=(0, -3.8, 1.7), rotation=(math.radians(82), 0, 0))
    scene.camera = bpy.context.object
    lens = scene.camera.data
    for number in (0, frames + 1):
        lens.lens = 24 + 16 * number / (frames + 1)
        lens.keyframe_insert("lens", frame=number)


def build_hair(scene: bpy.types.Scene, frames: int) -> None:
    """A ball of fur that turns by 2° a frame before a sky of one colour."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.7, location=(0, 0, 1))
    creature = bpy.context.object
    creature.data.materials.append(plain_material("skin", Base_Color=(0.5, 0.25, 0.12, 1), Roughness=0.6))
    hairs = bpy.data.hair_curves.new("fur")  # no particle system: it grows another fur in each run
    hairs.materials.append(creature.data.materials[0])
    draw, points, radii, steps = random.Random(3), [], [], 6
    for _ in range(7500):
        root, bent = (Vector([draw.gauss(0, 1) for _ in range(3)]).normalized() for _ in range(2))
        for t in (step / (steps - 1) for step in range(steps)):
            points.extend(0.7 * root + 0.35 * t * (root + 0.5 * t * bent))
            radii.append(0.006 * (1 - t))
    hairs.add_curves([steps] * (len(radii) // steps))
    hairs.position_data.foreach_set("vector", points)
    hairs.points.foreach_set("radius", radii)
    fur = bpy.data.objects.new("fur", hairs)
    fur.parent = creature
    scene.collection.objects.link(fur)
    for number in (0, frames + 1):
        creature.rotation_euler = (0, 0, math.radians(2 * number))
        creature.keyframe_insert("rotation_euler", frame=number)
    lamp_and_sky(scene)
    bpy.ops.object.camera_add(rotation=(math.radians(86), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.angle = math.radians(40)
    keyframe(scene.camera, frames, (-0.1, -3.6, 1.25), (0.2, -3.6, 1.25))


def build_shop(scene: bpy.types.Scene, frames: int) -> None:
    """A shop window with things behind it, seen as one walks past."""
    draw = random.Random(2)
    brick = material("brick", (0.35, 0.15, 0.1), (0.55, 0.3, 0.2), 4.0)
    white = plain_material("white", Base_Color=(0.75, 0.75, 0.75, 1))
    box("below", (0, 0, 0.3), (9, 0.15, 0.6), brick)
    box("above", (0, 0, 3.2), (9, 0.15, 1.2), brick)
    dark = plain_material("dark", Base_Color=(0.05, 0.05, 0.05, 1), Metallic=0.8, Roughness=0.3)
    for x in (-3.2, -1, 1.2, 3.4):
        box("post", (x, 0, 1.6), (0.12, 0.15, 2), dark)
    glass = plain_material("glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.45, Base_Color=(1, 1, 1, 1))
    box("pane", (0, 0, 1.6), (9, 0.02, 2), glass)
    tiles = material("tiles", (0.15, 0.12, 0.1), (0.7, 0.6, 0.5), 2.0, roughness=0.4)
    box("floor", (0, 2.5, -0.05), (9, 5, 0.1), tiles)
    box("back", (0, 5, 2), (9, 0.1, 4), material("paper", (0.3, 0.5, 0.4), (0.8, 0.75, 0.6), 2.5))
    box("ceiling", (0, 2.5, 3.85), (9, 5, 0.1), white)
    box("street", (0, -4, -0.05), (20, 8, 0.1), material("paving", (0.2, 0.2, 0.2), (0.4, 0.4, 0.4), 1.0))
    for number in range(9):
        colours = [[draw.uniform(0.05, 0.9) for _ in range(3)] for _ in range(2)]
        look, x, y = material(f"goods {number}", *colours, 4.0, 0.4), 0.9 * number - 3.6, draw.uniform(0.7, 3.5)
        if number % 2:
            box(f"goods {number}", (x, y, 0.6), (0.5, 0.5, 1.2), look)
        else:
            ball(f"goods {number}", (x, y, 1.0), 0.4, look)
            box(f"stand {number}", (x, y, 0.3), (0.4, 0.4, 0.6), white)
    for x in (-2.5, 0, 2.5):
        bpy.ops.object.light_add(type="AREA", location=(x, 2.2, 3.7))
        bpy.context.object.data.energy, bpy.context.object.data.size = 90, 0.5
    sky(scene, (0.15, 0.18, 0.25))
    bpy.ops.object.camera_add(rotation=(math.radians(89), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.angle = math.radians(62)
    keyframe(scene.camera, frames, (-0.7, -3.2, 1.6), (-0.7 + 0.09 * (frames - 1), -3.2, 1.6))


def build_mirror(scene: bpy.types.Scene, frames: int) -> None:
    """A room with a mirror on its back wall, and a ball that passes it."""
    draw = random.Random(6)
    plaster = material("plaster", (0.75, 0.68, 0.55), (0.25, 0.3, 0.45), 2.5)
    box("floor", (0, 0, -0.05), (6, 6, 0.1), material("tiles", (0.15, 0.12, 0.1), (0.7, 0.6, 0.5), 2.0, roughness=0.4))
    box("ceiling", (0, 0, 3.05), (6, 6, 0.1), plaster)
    box("back", (0, 3.05, 1.5), (6, 0.1, 3), plaster)
    box("front", (0, -3.05, 1.5), (6, 0.1, 3), material("paper", (0.2, 0.4, 0.5), (0.8, 0.7, 0.5), 3.0))
    box("left", (-3.05, 0, 1.5), (0.1, 6, 3), material("red", (0.8, 0.12, 0.08), (0.6, 0.3, 0.1), 3.0))
    box("right", (3.05, 0, 1.5), (0.1, 6, 3), material("green", (0.1, 0.45, 0.15), (0.35, 0.7, 0.25), 4.0))
    box("frame", (0.1, 2.98, 1.6), (2.8, 0.06, 1.7), plain_material("wood", Base_Color=(0.2, 0.1, 0.05, 1)))
    silver = plain_material("silver", Metallic=1.0, Roughness=0.0, Base_Color=(0.92, 0.92, 0.92, 1))
    box("mirror", (0.1, 2.96, 1.6), (2.6, 0.06, 1.5), silver)
    for number in range(7):
        colours = [[draw.uniform(0.05, 0.9) for _ in range(3)] for _ in range(2)]
        place = draw.uniform(-2.5, 2.5), draw.uniform(-1.5, 2.2), 0.4
        box(f"crate {number}", place, (0.5, 0.5, 0.8), material(f"crate {number}", *colours, 4.0))
    passing = ball("passing", (0, 0, 0), 0.3, material("blue", (0.1, 0.2, 0.7), (0.5, 0.6, 0.85), 5.0))
    reach = 0.1 * (frames - 1)
    keyframe(passing, frames, (-1, 0.5, 1.3), (-1 + reach, 0.5, 1.3))
    bpy.ops.object.light_add(type="AREA", location=(0.8, 0.3, 2.9))
    bpy.context.object.data.energy, bpy.context.object.data.size = 90, 0.6
    sky(scene, (0.1, 0.13, 0.2))
    bpy.ops.object.camera_add(rotation=(math.radians(84), 0, math.radians(2)))
    scene.camera = bpy.context.object
    scene.camera.data.angle = math.radians(70)
    keyframe(scene.camera, frames, (-0.4, -2.6, 1.5), (-0.4 + 0.8 * reach, -2.6 + 0.2 * reach, 1.55))


SETS = {
    "room": build, "still-life": build_still_life, "turntable": build_turntable, "meadow": build_meadow,
    "flicker": build_flicker, "evening": build_evening, "zoom": build_zoom,
    "hair": build_hair, "shop": build_shop, "mirror": build_mirror,
}  # fmt: skip
