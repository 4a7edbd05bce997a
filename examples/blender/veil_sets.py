"""Scenes for `render.py` that are seen through fog or a veil, as those of `sets`."""

from __future__ import annotations

import math

import bpy
from sets import box, build


def build_mist(scene: bpy.types.Scene, frames: int, density: float = 0.06) -> None:
    """The room of `sets`, full of mist: one sample in five is scattered before it hits anything."""
    build(scene, frames)
    air = bpy.data.materials.new("air")
    air.use_nodes = True
    nodes = air.node_tree.nodes
    nodes.remove(nodes["Principled BSDF"])
    scatter = nodes.new("ShaderNodeVolumeScatter")
    scatter.inputs["Density"].default_value = density
    air.node_tree.links.new(scatter.outputs["Volume"], nodes["Material Output"].inputs["Volume"])
    box("air", (0, -0.2, 1.5), (5.9, 8, 2.95), air)


def build_fog(scene: bpy.types.Scene, frames: int) -> None:
    """The same room in fog: two samples in three are scattered."""
    build_mist(scene, frames, density=0.25)


def build_veil(scene: bpy.types.Scene, frames: int) -> None:
    """The same room behind a veil that sways, of which two samples in five show the cloth."""
    build(scene, frames)
    cloth = bpy.data.materials.new("cloth")
    cloth.use_nodes = True
    inputs = cloth.node_tree.nodes["Principled BSDF"].inputs
    inputs["Alpha"].default_value, inputs["Base Color"].default_value = 0.4, (0.8, 0.75, 0.7, 1)
    place, turn = (-0.3, -0.9, 1.5), (math.radians(90), 0, 0)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=60, y_subdivisions=4, size=1, location=place, rotation=turn)
    veil = bpy.context.object
    veil.scale = 2.2, 2.4, 1
    veil.data.materials.append(cloth)
    bpy.ops.object.shade_smooth()
    wave = veil.modifiers.new("wave", "WAVE")
    wave.height, wave.width, wave.narrowness, wave.speed, wave.time_offset = 0.08, 0.25, 6, 0.04, -200


VEIL_SETS = {"mist": build_mist, "fog": build_fog, "veil": build_veil}
