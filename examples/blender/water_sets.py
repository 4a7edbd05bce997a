"""Sets for `render.py` in which samples are lost: water and glass."""

from __future__ import annotations

import math

import bpy
from sets import ball, box, build, keyframe, material, plain_material, sky, sunlight


def build_ocean(scene: bpy.types.Scene, frames: int) -> None:
    """Waves that move, seen at a low angle, and a buoy."""
    bpy.ops.mesh.primitive_plane_add(size=1)
    sea = bpy.context.object
    waves = sea.modifiers.new("waves", "OCEAN")
    waves.geometry_mode, waves.resolution, waves.spatial_size = "GENERATE", 12, 30
    waves.wave_scale, waves.choppiness = 0.8, 1
    for k in (0, frames + 1):
        waves.time = 1 + 0.12 * k
        waves.keyframe_insert("time", frame=k)
    sea.scale = 2, 2, 2
    sea.data.materials.append(plain_material("water", Base_Color=(0.01, 0.05, 0.07, 1), Roughness=0.08, IOR=1.33))
    ball("buoy", (0, 6, 0.3), 0.7, material("buoy", (0.8, 0.1, 0.05), (0.9, 0.9, 0.9), 2.0))
    sunlight((1.0, 0.3, 0), 0.01)
    sky(scene, (0.4, 0.55, 0.8))
    bpy.ops.object.camera_add(rotation=(math.radians(82), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.5, -3, 3), (0.05 * (frames - 1) - 0.5, -3, 3))


def build_pool(scene: bpy.types.Scene, frames: int) -> None:
    """The room of `sets`, with water on its floor whose waves are painted."""
    build(scene, frames)
    water = plain_material("water", Roughness=0.02, Transmission_Weight=1.0, IOR=1.33)
    nodes, links = water.node_tree.nodes, water.node_tree.links
    kinds = "TexCoord", "Mapping", "TexNoise", "Bump"
    coordinates, mapping, noise, bump = (nodes.new(f"ShaderNode{kind}") for kind in kinds)
    noise.inputs["Scale"].default_value, bump.inputs["Strength"].default_value = 5, 0.35
    links.new(coordinates.outputs["Object"], mapping.inputs["Vector"])
    links.new(mapping.outputs[0], noise.inputs["Vector"])
    links.new(noise.outputs[0], bump.inputs["Height"])
    links.new(bump.outputs[0], nodes["Principled BSDF"].inputs["Normal"])
    place = mapping.inputs["Location"]
    for k in (0, frames + 1):
        place.default_value = 0.02 * k, 0, 0.05 * k
        place.keyframe_insert("default_value", frame=k)
    box("pool", (0, -0.6, 0.2), (5, 3, 0.3), water)


def build_glass(scene: bpy.types.Scene, frames: int) -> None:
    """A monkey of wax that turns, and a ball of glass."""
    box("table", (0, 0, -0.05), (6, 6, 0.1), material("wood", (0.25, 0.12, 0.05), (0.5, 0.3, 0.15), 6.0, 0.4))
    box("wall", (0, 2.5, 1.5), (6, 0.1, 3), material("wall", (0.6, 0.6, 0.55), (0.4, 0.45, 0.5), 2.0))
    bpy.ops.mesh.primitive_monkey_add(size=1.1, location=(-0.6, 0, 0.7))
    bpy.ops.object.shade_smooth()
    monkey = bpy.context.object
    wax = plain_material("wax", Base_Color=(0.8, 0.5, 0.4, 1), Subsurface_Weight=1.0, Roughness=0.45)
    wax.node_tree.nodes["Principled BSDF"].inputs["Subsurface Radius"].default_value = 0.3, 0.1, 0.05
    monkey.data.materials.append(wax)
    for k in (0, frames + 1):
        monkey.rotation_euler = 0, 0, 0.05 * k - 0.3
        monkey.keyframe_insert("rotation_euler", frame=k)
    glass = plain_material("glass", Transmission_Weight=1.0, Roughness=0.0, IOR=1.45)
    ball("glass", (0.8, -0.2, 0.4), 0.4, glass)
    bpy.ops.object.light_add(type="AREA", location=(2, -1.5, 3))
    lamp = bpy.context.object
    lamp.data.energy, lamp.data.size = 150, 0.4
    lamp.rotation_euler = lamp.location.to_track_quat("Z", "Y").to_euler()
    sky(scene, (0.05, 0.06, 0.08))
    bpy.ops.object.camera_add(rotation=(math.radians(80), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (-0.2, -3.6, 1.4), (0.03 * (frames - 1) - 0.2, -3.6, 1.4))


WATER_SETS = {"ocean": build_ocean, "pool": build_pool, "glass": build_glass}
