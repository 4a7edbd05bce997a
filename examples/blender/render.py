"""Render an animated scene with Blender's Cycles at 1 sample per pixel, with the passes that a temporal denoiser needs.

    python -m venv bpyenv && bpyenv/bin/pip install bpy          # Python 3.11; 0.8 GB when installed
    bpyenv/bin/python examples/blender/render.py shot/ --frames 12
    bpyenv/bin/python examples/blender/render.py shot/ --scene my.blend          # its own camera, frames and size

Without --scene it builds a room from primitives: textured walls and floor, still objects, a post that slides past the
back wall and uncovers it, a ball that jumps, and a camera that moves along both axes of the picture. Copy `configure`
and `add_passes` into a script of your own.
"""

from __future__ import annotations

import argparse
import math
import random
from pathlib import Path

import bpy

LIGHT_PASSES = ("diffuse_direct", "diffuse_indirect", "diffuse_color", "glossy_direct", "glossy_indirect",
                "glossy_color", "transmission_direct", "transmission_indirect", "transmission_color", "emit",
                "environment")  # fmt: skip
VOLUME_PASSES = ("volume_direct", "volume_indirect")


def add_passes(scene: bpy.types.Scene) -> None:
    """Switch on the passes that `rtdenoise` reads, in one multilayer EXR a frame."""
    layer = scene.view_layers[0]
    layer.cycles.denoising_store_passes = True  # Denoising Albedo, Normal, Depth
    for name in ("combined", "z", "normal", "vector", *LIGHT_PASSES):
        setattr(layer, f"use_pass_{name}", True)
    for name in VOLUME_PASSES:
        setattr(layer.cycles, f"use_pass_{name}", True)
    for other in scene.view_layers:
        other.use = other == layer
    scene.render.use_motion_blur = False  # with motion blur Cycles writes no vectors, or zeros
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "16"  # of the colours: Cycles writes depth, normals and vectors as 32-bit float all the same
    settings.exr_codec = "ZIP"


def configure(scene: bpy.types.Scene, width: int, height: int, samples: int, seed: int = 1) -> None:
    """Cycles on the CPU, with new noise in every frame and no filter on it; every frame, whole, and as rendered."""
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples, scene.cycles.time_limit, scene.view_layers[0].samples = samples, 0, 0
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.seed = seed
    scene.cycles.use_animated_seed = True
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.use_compositing = render.use_sequencer = render.use_border = render.use_multiview = False
    render.use_overwrite = render.use_file_extension = True
    scene.frame_step = 1


def simulate(scene: bpy.types.Scene) -> None:
    """Run through the frames once, so that physics are in Blender's cache: motion vectors take the frame after, to
    which they would jump."""
    for number in range(scene.frame_start - 1, scene.frame_end + 2):
        scene.frame_set(number)


def own_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """Width and height set in the file, in pixels."""
    render = scene.render
    return tuple(n * render.resolution_percentage // 100 for n in (render.resolution_x, render.resolution_y))


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
    fur = creature.modifiers.new("fur", "PARTICLE_SYSTEM").particle_system.settings
    fur.type, fur.count, fur.hair_length, fur.use_advanced_hair = "HAIR", 1500, 0.35, True
    fur.brownian_factor, fur.child_type, fur.rendered_child_count = 0.05, "SIMPLE", 4
    fur.root_radius, fur.tip_radius, fur.radius_scale = 0.012, 0.0, 1.0
    for number in (0, frames + 1):
        creature.rotation_euler = (0, 0, math.radians(2 * number))
        creature.keyframe_insert("rotation_euler", frame=number)
    lamp_and_sky(scene)
    bpy.ops.object.camera_add(rotation=(math.radians(86), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.angle = math.radians(40)
    keyframe(scene.camera, frames, (-0.1, -3.6, 1.25), (0.2, -3.6, 1.25))


SETS = {
    "room": build, "still-life": build_still_life, "turntable": build_turntable, "meadow": build_meadow,
    "flicker": build_flicker, "evening": build_evening, "zoom": build_zoom,
    "hair": build_hair,
}  # fmt: skip


def straighten() -> None:
    """Constant speed instead of Blender's eased curves."""
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for frame.0001.exr …")
    parser.add_argument("--scene", type=Path, help="a .blend file to render instead of the room")
    parser.add_argument("--set", choices=SETS, default="room", help="what to build without --scene")
    parser.add_argument("--frames", type=int, help="default: 12, or as in the file")
    parser.add_argument("--width", type=int, help="default: 320, or as in the file")
    parser.add_argument("--height", type=int, help="default: 180, or as in the file")
    parser.add_argument("--samples", type=int, default=1, help="per pixel")
    parser.add_argument("--transparent", action="store_true", help="no sky in the picture, but alpha")
    parser.add_argument("--seed", type=int, default=1, help="of the noise: another for a reference")
    options = parser.parse_args()

    if options.scene:
        if not options.scene.is_file():
            parser.error(f"{options.scene}: no such file")
        bpy.ops.wm.open_mainfile(filepath=str(options.scene.resolve()))
        scene = bpy.context.scene
        if scene.camera is None:
            parser.error(f"{options.scene}: the scene has no camera")
        width, height = own_size(scene)
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene, width, height = bpy.context.scene, 320, 180
        straighten()
        SETS[options.set](scene, options.frames or 12)
        scene.frame_start, scene.frame_end = 1, 12
    if options.frames:
        scene.frame_end = scene.frame_start + options.frames - 1
    configure(scene, options.width or width, options.height or height, options.samples, options.seed)
    add_passes(scene)
    scene.render.film_transparent |= options.transparent
    if options.scene:
        simulate(scene)
    scene.render.filepath = str(options.out.resolve() / "frame.####")
    bpy.ops.render.render(animation=True)


if __name__ == "__main__":
    main()
