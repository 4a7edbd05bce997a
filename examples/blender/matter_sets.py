"""Sets for `render.py` of matter that is hard to light: leaves cut out by alpha, wax, a wet street. References of `wax`
need 192 samples."""

from __future__ import annotations

import math
import random

import bpy
from mathutils import Vector
from sets import box, keyframe, material, plain_material, sky, sunlight


def build_canopy(scene: bpy.types.Scene, frames: int) -> None:
    """Trees of leaves that a texture's alpha cuts out, with the sun through them, seen as one walks past."""
    draw = random.Random(8)
    box("ground", (0, 6, -0.05), (30, 30, 0.1), material("earth", (0.3, 0.24, 0.16), (0.55, 0.5, 0.35), 1.5))
    bark = material("bark", (0.08, 0.05, 0.03), (0.3, 0.22, 0.15), 6)
    box("wall", (0, 11, 1), (30, 0.3, 2), material("wall", (0.4, 0.35, 0.3), (0.65, 0.6, 0.55), 3))
    bpy.ops.mesh.primitive_plane_add(size=0.45, location=(0, 0, -9))  # a twig's leaves, which other objects share
    twig = bpy.context.object.data
    twig.materials.append(leaves())
    trees = (-2.4, 2.5, 2.8), (1.8, 3.5, 3.2), (-0.8, 7, 3.4), (-1.6, -2, 4.2), (0.6, 0.4, 0)
    for n, (x, y, high) in enumerate(trees):
        if high:
            box(f"trunk{n}", (x, y, high / 2), (0.22, 0.22, high), bark)
        for leaf in range(300 if high else 120):
            made = bpy.data.objects.new(f"leaf{n}.{leaf}", twig)
            out = Vector([draw.gauss(0, 1) for _ in range(3)]).normalized() * (1.6 if high else 0.5)
            made.location = Vector((x, y, high or 0.3)) + out * draw.uniform(0.3, 1) ** 0.5
            made.rotation_euler = [draw.uniform(0, 6) for _ in range(3)]
            scene.collection.objects.link(made)
    sunlight((math.radians(38), math.radians(28), 0), 0.009)
    sky(scene, (0.3, 0.42, 0.6))
    bpy.ops.object.camera_add(rotation=(math.radians(86), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.35, -4, 1.6), (0.35, -4, 1.6))


def leaves() -> bpy.types.Material:
    """Four leaves on a square of a picture, between which there is nothing."""
    size, pixels = 64, []
    for row in range(size):
        for column in range(size):
            x, y = (column / size * 2) % 1 - 0.5, (row / size * 2) % 1 - 0.5
            along, across = x + y, x - y
            inside = abs(across) < 0.3 * (1 - along * along) - 0.04 * math.cos(25 * along)
            vein = 1.5 if abs(across) < 0.04 else 1.0
            pixels += 0.16 * vein, (0.34 + 0.1 * y) * vein, 0.05 * vein, float(inside)
    picture = bpy.data.images.new("leaves", size, size, alpha=True)
    picture.pixels = pixels
    picture.pack()
    made = plain_material("leaves", Roughness=0.5)
    nodes, links = made.node_tree.nodes, made.node_tree.links
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = picture
    links.new(texture.outputs["Color"], nodes["Principled BSDF"].inputs["Base Color"])
    links.new(texture.outputs["Alpha"], nodes["Principled BSDF"].inputs["Alpha"])
    return made


def build_wax(scene: bpy.types.Scene, frames: int) -> None:
    """Candles and a bust of wax, which light goes through, lit by small flames, seen by a camera that goes round."""
    box("table", (0, 0, -0.05), (6, 6, 0.1), material("table", (0.14, 0.08, 0.05), (0.4, 0.28, 0.18), 5, 0.35))
    box("wall", (0, 2.5, 1.5), (8, 0.1, 3.2), material("wall", (0.3, 0.25, 0.22), (0.5, 0.42, 0.36), 2))
    bpy.ops.mesh.primitive_monkey_add(size=1.3, location=(0.25, 0.5, 0.62), rotation=(math.radians(-14), 0, -0.3))
    bpy.ops.object.shade_smooth()
    bpy.context.object.modifiers.new("smooth", "SUBSURF").render_levels = 2
    bpy.context.object.data.materials.append(wax("bust", (0.8, 0.62, 0.45, 1)))
    flame = plain_material("flame", Base_Color=(0, 0, 0, 1), Emission_Color=(1, 0.6, 0.25, 1), Emission_Strength=240.0)
    candles = ((-1.0, 0.1, 0.7, (0.85, 0.8, 0.7, 1)), (-0.6, -0.6, 0.35, (0.75, 0.12, 0.08, 1)),
               (1.15, -0.3, 0.55, (0.8, 0.7, 0.3, 1)), (1.3, 0.7, 0.95, (0.3, 0.5, 0.3, 1)))  # fmt: skip
    for n, (x, y, high, colour) in enumerate(candles):
        bpy.ops.mesh.primitive_cylinder_add(radius=0.16, depth=high, location=(x, y, high / 2), vertices=48)
        bpy.context.object.data.materials.append(wax(f"candle{n}", colour))
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.025, location=(x, y, high + 0.1))
        bpy.context.object.scale.z = 2.2
        bpy.context.object.data.materials.append(flame)
    sky(scene, (0.01, 0.012, 0.02))
    bpy.ops.object.empty_add(location=(0.1, 0.2, 0.5))
    middle = bpy.context.object
    for number in (0, frames + 1):
        middle.rotation_euler.z = math.radians(1.2 * number - 5)
        middle.keyframe_insert("rotation_euler", frame=number)
    bpy.ops.object.camera_add(location=(0, -3.9, 0.9), rotation=(math.radians(77), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.parent = middle


def wax(name: str, colour: tuple) -> bpy.types.Material:
    """Light wanders in it, by some centimetres, red light farthest."""
    return plain_material(
        name,
        Base_Color=colour,
        Roughness=0.35,
        Subsurface_Weight=1.0,
        Subsurface_Radius=(1.0, 0.45, 0.2),
        Subsurface_Scale=0.12,
    )


def build_wet(scene: bpy.types.Scene, frames: int) -> None:
    """A street in the rain at night, whose asphalt mirrors lamps and signs, and a car that comes, as one walks on."""
    draw = random.Random(12)
    box("road", (0, 20, -0.05), (14, 60, 0.1), asphalt())
    for n in range(14):
        side, along = 1 - n % 2 * 2, 4 * (n // 2)
        high = draw.uniform(5, 9)
        dark, light = ([draw.uniform(0.05, 0.4) for _ in range(3)] for _ in range(2))
        box(f"house{n}", (side * 6, along, high / 2), (3, 3.8, high), material(f"house{n}", dark, light, 2))
        colour = draw.choice(((1, 0.1, 0.15), (0.1, 0.8, 1), (1, 0.2, 0.8), (0.2, 1, 0.3), (1, 0.75, 0.2)))
        place = side * 4.3, along + draw.uniform(-1, 1), draw.uniform(1.6, 3.4)
        box(f"sign{n}", place, (0.3, 0.06, draw.uniform(0.25, 0.7)), glowing(f"sign{n}", colour, 12))
    iron = plain_material("iron", Base_Color=(0.1, 0.1, 0.1, 1))
    for n in range(4):
        box(f"post{n}", (-3.2, 3 + 6 * n, 2), (0.08, 0.08, 4), iron)
        box(f"lamp{n}", (-2.9, 3 + 6 * n, 4), (0.5, 0.15, 0.06), glowing(f"lamp{n}", (1, 0.7, 0.35), 60))
    paint = plain_material("paint", Base_Color=(0.25, 0.03, 0.03, 1), Coat_Weight=1.0, Roughness=0.4)
    car = box("car", (0, 0, 0), (1.7, 3.6, 0.7), paint)
    cabin = box("cabin", (0, 0.3, 0.6), (1.4, 1.8, 0.55), plain_material("panes", Roughness=0.05, Metallic=0.6))
    lights = [box(f"light{x}", (x, -1.82, 0.05), (0.25, 0.05, 0.15), glowing("light", (1, 0.95, 0.8), 50))
              for x in (-0.6, 0.6)]  # fmt: skip
    for part in (cabin, *lights):
        part.parent = car
    keyframe(car, frames, (1.3, 8.5, 0.6), (1.3, 8.5 - 0.22 * (frames - 1), 0.6))
    sky(scene, (0.004, 0.005, 0.009))
    bpy.ops.object.camera_add(rotation=(math.radians(84), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.4, -3, 1.5), (-0.4, -3 + 0.09 * (frames - 1), 1.5))


def glowing(name: str, colour: tuple, strength: float) -> bpy.types.Material:
    return plain_material(name, Base_Color=(0, 0, 0, 1), Emission_Color=(*colour, 1), Emission_Strength=strength)


def asphalt() -> bpy.types.Material:
    """Dark stone under water: smooth in its puddles, rough and uneven between them."""
    made = plain_material("asphalt", Base_Color=(0.03, 0.03, 0.035, 1))
    nodes, links = made.node_tree.nodes, made.node_tree.links
    place, puddles, grain, ramp, bump = (
        nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "TexNoise", "TexNoise", "ValToRGB", "Bump")
    )
    puddles.inputs["Scale"].default_value, grain.inputs["Scale"].default_value = 0.7, 25.0
    ramp.color_ramp.elements[0].position, ramp.color_ramp.elements[0].color = 0.42, (0.04, 0.04, 0.04, 1)
    ramp.color_ramp.elements[1].position, ramp.color_ramp.elements[1].color = 0.58, (0.3, 0.3, 0.3, 1)
    bump.inputs["Strength"].default_value, bump.inputs["Distance"].default_value = 0.25, 0.02
    for noise in (puddles, grain):
        links.new(place.outputs["Object"], noise.inputs["Vector"])
    links.new(puddles.outputs["Fac"], ramp.inputs["Fac"])
    links.new(ramp.outputs["Color"], nodes["Principled BSDF"].inputs["Roughness"])
    links.new(grain.outputs["Fac"], bump.inputs["Height"])
    links.new(bump.outputs["Normal"], nodes["Principled BSDF"].inputs["Normal"])
    return made


def build_dappled(scene: bpy.types.Scene, frames: int) -> None:
    """A bust that turns before a papered wall, in sun that falls through leaves out of sight, which sway."""
    draw = random.Random(4)
    box("wall", (0, 2.2, 1.5), (8, 0.1, 5), material("paper", (0.75, 0.7, 0.6), (0.45, 0.5, 0.42), 9))
    box("floor", (0, 0, -0.05), (8, 6, 0.1), material("floor", (0.3, 0.2, 0.1), (0.5, 0.4, 0.3), 4))
    bpy.ops.mesh.primitive_monkey_add(size=1.7, location=(0.1, 0.4, 1.2))
    face = bpy.context.object
    face.modifiers.new("smooth", "SUBSURF").render_levels = 2
    bpy.ops.object.shade_smooth()
    skin = {"Base_Color": (0.75, 0.48, 0.36, 1), "Roughness": 0.45, "Subsurface_Weight": 0.3, "Subsurface_Scale": 0.05}
    face.data.materials.append(plain_material("skin", **skin))
    for k in range(frames + 2):
        face.rotation_euler = math.radians(-12), 0, math.radians(12 + 0.7 * k)
        face.keyframe_insert("rotation_euler", frame=k)
    box("scarf", (0.1, 0.5, 0.25), (1.3, 0.8, 0.5), material("scarf", (0.6, 0.05, 0.08), (0.9, 0.75, 0.2), 14))
    crowns = []
    for c in range(3):
        crown = bpy.data.objects.new(f"crown {c}", None)
        scene.collection.objects.link(crown)
        crowns.append(crown)
        for k in range(frames + 2):
            crown.location = 0.07 * math.sin(0.7 * k + c) + 0.05 * k * (c == 1), 0, 0.05 * math.cos(0.6 * k + 2 * c)
            crown.keyframe_insert("location", frame=k)
    bpy.ops.mesh.primitive_plane_add(size=1)
    leaf = bpy.context.object
    leaf.data.materials.append(plain_material("leaf", Base_Color=(0.1, 0.3, 0.05, 1)))
    for n in range(420):
        other = bpy.data.objects.new(f"leaf {n}", leaf.data)
        scene.collection.objects.link(other)
        other.parent, away = crowns[n % 3], draw.uniform(2.6, 4.2)
        x, y, z = draw.uniform(-2.4, 2.4), draw.uniform(-2.2, 1.6), draw.uniform(-0.8, 1)
        other.location = x + 0.72 * away, y - 0.55 * away, 1.2 + z + 0.75 * away  # towards the sun
        other.rotation_euler = [draw.uniform(0, 3) for _ in range(3)]
        other.scale = [draw.uniform(0.1, 0.32), draw.uniform(0.08, 0.2), 1]
    bpy.data.objects.remove(leaf)
    sunlight((math.atan2(0.55, 0.75), math.atan2(0.72, 0.93), 0), 0.012)
    bpy.context.object.data.energy = 2.5
    sky(scene, (0.07, 0.09, 0.13))
    bpy.ops.object.camera_add(rotation=(math.radians(88), 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.lens = 35
    keyframe(scene.camera, frames, (-0.1, -3.3, 1.35), (0.05, -3.3, 1.33))


MATTER_SETS = {"canopy": build_canopy, "wax": build_wax, "wet": build_wet, "dappled": build_dappled}
