"""Sets for `render.py` in which small things are bright: windows at night, flakes in paint, a fire, dots of light."""

from __future__ import annotations

import math
import random

import bpy
from sets import ball, box, keyframe, material, plain_material, sky, sunlight


def build_skyline(scene: bpy.types.Scene, frames: int) -> None:
    """Houses at night whose lit windows are a pixel or two wide, behind posts, seen as one drives past."""
    draw = random.Random(21)
    box("ground", (0, 40, -0.05), (120, 120, 0.1), plain_material("ground", Base_Color=(0.06, 0.06, 0.07, 1)))
    for n in range(16):
        wide, high = draw.uniform(5, 9), draw.uniform(8, 24)
        place = draw.uniform(-30, 30), draw.uniform(36, 60), high / 2
        box(f"house{n}", place, (wide, 5, high), lit_windows(f"house{n}", draw))
    for n in range(4):
        box(f"post{n}", (3 * n - 5, 6, 1.5), (0.12, 0.12, 3), plain_material(f"post{n}", Base_Color=(0.3, 0.3, 0.3, 1)))
    sky(scene, (0.004, 0.006, 0.012))
    bpy.ops.object.camera_add(rotation=(math.radians(95), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.5, 0, 1.6), (0.6, 0.4, 1.6))


def lit_windows(name: str, draw: random.Random) -> bpy.types.Material:
    """A dark wall with windows, of which some are lit, in many shades."""
    made = plain_material(name, Base_Color=(0.1, 0.09, 0.08, 1), Emission_Strength=draw.uniform(2, 6))
    nodes, links = made.node_tree.nodes, made.node_tree.links
    bricks, coordinates, turn = (nodes.new(f"ShaderNode{kind}") for kind in ("TexBrick", "TexCoord", "Mapping"))
    bricks.offset = 0.0
    for key, value in (("Scale", 1.0), ("Brick Width", 0.6), ("Row Height", 0.7), ("Mortar Size", 0.2), ("Bias", -0.2)):
        bricks.inputs[key].default_value = value
    for key, value in (
        ("Color1", (0, 0, 0, 1)),
        ("Color2", (1, draw.uniform(0.6, 0.9), 0.5, 1)),
        ("Mortar", (0, 0, 0, 1)),
    ):
        bricks.inputs[key].default_value = value
    turn.inputs["Rotation"].default_value = math.radians(90), 0, 0
    links.new(coordinates.outputs["Object"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], bricks.inputs["Vector"])
    links.new(bricks.outputs["Color"], nodes["Principled BSDF"].inputs["Emission Color"])
    return made


def build_paint(scene: bpy.types.Scene, frames: int) -> None:
    """A ball and a box of car paint that turn in the sun: its flakes glitter."""
    box("ground", (0, 0, -0.05), (12, 12, 0.1), material("slabs", (0.3, 0.28, 0.25), (0.6, 0.58, 0.5), 2))
    for item in (
        ball("ball", (-0.9, 0.2, 0.8), 0.8, flaked("red", (0.5, 0.02, 0.03, 1))),
        box("box", (0.9, 0.4, 0.6), (1.2, 1.2, 1.2), flaked("blue", (0.02, 0.08, 0.4, 1))),
    ):
        for number in (0, frames + 1):
            item.rotation_euler.z = math.radians(1.5) * number
            item.keyframe_insert("rotation_euler", frame=number)
    sunlight((math.radians(40), math.radians(20), 0), 0.01)
    sky(scene, (0.25, 0.35, 0.5))
    bpy.ops.object.camera_add(rotation=(math.radians(76), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.1, -4.5, 1.8), (0.1, -4.5, 1.8))


def flaked(name: str, colour: tuple) -> bpy.types.Material:
    """Metal in flakes that lie askew, under lacquer."""
    made = plain_material(name, Base_Color=colour, Metallic=0.9, Roughness=0.3, Coat_Weight=1.0, Coat_Roughness=0.03)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    flakes, coordinates, normal = (nodes.new(f"ShaderNode{kind}") for kind in ("TexVoronoi", "TexCoord", "NormalMap"))
    flakes.inputs["Scale"].default_value = 90.0
    normal.inputs["Strength"].default_value = 0.15
    links.new(coordinates.outputs["Object"], flakes.inputs["Vector"])
    links.new(flakes.outputs["Color"], normal.inputs["Color"])
    links.new(normal.outputs["Normal"], nodes["Principled BSDF"].inputs["Normal"])
    return made


def build_fire(scene: bpy.types.Scene, frames: int) -> None:
    """A fire between crates at night, of glowing gas whose shape changes; it is the only light."""
    draw = random.Random(4)
    box("ground", (0, 0, -0.05), (12, 12, 0.1), material("earth", (0.1, 0.08, 0.06), (0.35, 0.3, 0.2), 4))
    for n in range(9):
        dark, light = ([draw.uniform(0.1, 0.8) for _ in range(3)] for _ in range(2))
        angle, high = 0.4 + 0.32 * n, draw.uniform(0.4, 1.2)
        place = 2.2 * math.cos(angle), 2.2 * math.sin(angle), high / 2
        box(f"crate{n}", place, (0.5, 0.5, high), material(f"crate{n}", dark, light, 6))
    flames = box("flames", (0, 0, 0.75), (0.9, 0.9, 1.5), bpy.data.materials.new("flames"))
    made = flames.data.materials[0]
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.remove(nodes["Principled BSDF"])
    gas, noise, coordinates = (nodes.new(f"ShaderNode{kind}") for kind in ("VolumePrincipled", "TexNoise", "TexCoord"))
    ramp, body, shape = (nodes.new(f"ShaderNode{kind}") for kind in ("ValToRGB", "TexGradient", "Mapping"))
    both, bright = nodes.new("ShaderNodeMath"), nodes.new("ShaderNodeMath")
    noise.noise_dimensions, noise.inputs["Scale"].default_value = "4D", 3.0
    for number in (0, frames + 1):
        noise.inputs["W"].default_value = 0.12 * number
        noise.inputs["W"].keyframe_insert("default_value", frame=number)
    body.gradient_type, shape.inputs["Scale"].default_value = "SPHERICAL", (2.2, 2.2, 1.3)
    both.operation = bright.operation = "MULTIPLY"
    bright.inputs[1].default_value = 60.0
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[1].position = 0.15, 0.5
    links.new(coordinates.outputs["Object"], noise.inputs["Vector"])
    links.new(coordinates.outputs["Object"], shape.inputs["Vector"])
    links.new(shape.outputs["Vector"], body.inputs["Vector"])
    links.new(noise.outputs["Fac"], both.inputs[0])
    links.new(body.outputs["Fac"], both.inputs[1])
    links.new(both.outputs["Value"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], bright.inputs[0])
    links.new(bright.outputs["Value"], gas.inputs["Emission Strength"])
    gas.inputs["Density"].default_value, gas.inputs["Emission Color"].default_value = 0.3, (1, 0.35, 0.08, 1)
    links.new(gas.outputs["Volume"], nodes["Material Output"].inputs["Volume"])
    sky(scene, (0.004, 0.005, 0.01))
    bpy.ops.object.camera_add(rotation=(math.radians(78), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.15, -4.6, 1.6), (0.15, -4.6, 1.6))


def hall(scene: bpy.types.Scene, frames: int) -> None:
    """A room with a table and a ball, open behind the camera, which moves a little, in hardly any light."""
    plaster = material("plaster", (0.75, 0.72, 0.68), (0.65, 0.6, 0.58), 2)
    boards = material("boards", (0.35, 0.2, 0.1), (0.55, 0.35, 0.2), 3, roughness=0.5)
    box("floor", (0, 0, -0.05), (6, 6, 0.1), boards)
    box("ceiling", (0, 0, 3.05), (6, 6, 0.1), plaster)
    box("back", (0, 3.05, 1.5), (6, 0.1, 3), plaster)
    for name, side in (("left", -3.05), ("right", 3.05)):
        box(name, (side, 0, 1.5), (0.1, 6, 3), plaster)
    box("table", (0.3, 1.2, 0.4), (1.2, 0.8, 0.8), material("blue", (0.2, 0.3, 0.6), (0.6, 0.6, 0.7), 4))
    ball("ball", (-1.2, 1.5, 0.4), 0.4, material("red", (0.7, 0.2, 0.1), (0.9, 0.6, 0.2), 6))
    sky(scene, (0.04, 0.05, 0.08))
    bpy.ops.object.camera_add(rotation=(math.radians(88), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 24
    keyframe(scene.camera, frames, (-0.2, -3.4, 1.5), (0.2, -3.3, 1.5))


def build_disco(scene: bpy.types.Scene, frames: int) -> None:
    """Dots of light that a mirror ball throws sweep a room and what stands in it, by 3° a frame."""
    hall(scene, frames)
    bpy.ops.object.light_add(type="POINT", location=(0, 0.8, 2.2))
    lamp = bpy.context.object.data
    lamp.energy, lamp.shadow_soft_size, lamp.use_nodes = 3000, 0.01, True
    turn = {"Rotation": (0, 0, math.radians(3))}
    dots = moving_dots(lamp.node_tree, "Normal", 7, {0.18: (1, 1, 1, 1), 0.24: (0.01, 0.01, 0.012, 1)}, turn, frames)
    lamp.node_tree.links.new(dots, lamp.node_tree.nodes["Emission"].inputs["Color"])


def build_slides(scene: bpy.types.Scene, frames: int) -> None:
    """The same room, in which a projector shows another slide every two frames."""
    hall(scene, frames)
    bpy.ops.object.light_add(type="SPOT", location=(0, -2.9, 1.9), rotation=(math.radians(87), 0, 0))
    lamp = bpy.context.object.data
    lamp.energy, lamp.shadow_soft_size, lamp.use_nodes = 500, 0.01, True
    lamp.spot_size, lamp.spot_blend = 0.85, 0.05
    nodes, links = lamp.node_tree.nodes, lamp.node_tree.links
    slide, coordinates = nodes.new("ShaderNodeTexVoronoi"), nodes.new("ShaderNodeTexCoord")
    slide.voronoi_dimensions, slide.inputs["Scale"].default_value = "4D", 9
    for number in range(frames + 2):
        slide.inputs["W"].default_value = 7.3 * (number // 2)
        slide.inputs["W"].keyframe_insert("default_value", frame=number)
    links.new(coordinates.outputs["Normal"], slide.inputs["Vector"])
    links.new(slide.outputs["Color"], nodes["Emission"].inputs["Color"])


def moving_dots(
    tree: bpy.types.NodeTree, source: str, scale: float, colours: dict, step: dict, frames: int
) -> bpy.types.NodeSocket:
    """Cells of a Voronoi pattern over a texture coordinate, coloured by the distance from their middles; by how much a
    Mapping's input changes from frame to frame says `step`."""
    nodes, links = tree.nodes, tree.links
    dots, coordinates, place, ramp = (
        nodes.new(f"ShaderNode{kind}") for kind in ("TexVoronoi", "TexCoord", "Mapping", "ValToRGB")
    )
    dots.inputs["Scale"].default_value = scale
    for stop, (distance, colour) in zip(ramp.color_ramp.elements, colours.items(), strict=True):
        stop.position, stop.color = distance, colour
    (name, change), *_ = step.items()
    for number in (0, frames + 1):
        place.inputs[name].default_value = [number * x for x in change]
        place.inputs[name].keyframe_insert("default_value", frame=number)
    links.new(coordinates.outputs[source], place.inputs["Vector"])
    links.new(place.outputs["Vector"], dots.inputs["Vector"])
    links.new(dots.outputs["Distance"], ramp.inputs["Fac"])
    return ramp.outputs["Color"]


def build_ticker(scene: bpy.types.Scene, frames: int) -> None:
    """Lamps of a running text, a few pixels wide, on a wall above crates that slide."""
    lamps = plain_material("lamps", Base_Color=(0, 0, 0, 1), Emission_Strength=6)
    move = {"Location": (0.048, 0, 0)}
    dots = moving_dots(lamps.node_tree, "Object", 10, {0.35: (1, 0.2, 0.05, 1), 0.37: (0, 0, 0, 1)}, move, frames)
    lamps.node_tree.links.new(dots, lamps.node_tree.nodes["Principled BSDF"].inputs["Emission Color"])
    box("floor", (0, 0, -0.05), (8, 6, 0.1), material("floor", (0.35, 0.2, 0.1), (0.55, 0.35, 0.2), 3))
    box("wall", (0, 3.05, 1.5), (8, 0.1, 3), material("wall", (0.75, 0.72, 0.68), (0.65, 0.6, 0.58), 2))
    box("sign", (0, 2.95, 2), (4, 0.05, 0.6), lamps)
    for n in range(4):
        card = material(f"card{n}", (0.6, 0.4, 0.25), (0.5, 0.3, 0.2), 4)
        crate = box(f"crate{n}", (0, 0, 0), (0.5, 0.5, 0.5), card)
        start = 1.2 * n - 2.4
        keyframe(crate, frames, (start, 0.6, 0.25), (start + 0.12 * (frames - 1), 0.6, 0.25))
    bpy.ops.object.light_add(type="AREA", location=(0, 0, 2.9))
    bpy.context.object.data.energy, bpy.context.object.data.size = 60, 1.0
    sky(scene, (0.1, 0.11, 0.13))
    bpy.ops.object.camera_add(location=(0, -3.2, 1.7), rotation=(math.radians(82), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 24


GLOW_SETS = {
    "skyline": build_skyline,
    "paint": build_paint,
    "fire": build_fire,
    "disco": build_disco,
    "slides": build_slides,
    "ticker": build_ticker,
}
