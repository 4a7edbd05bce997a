"""Scenes for `render.py` that are seen through fog or a veil, or in alpha, as those of `sets`."""

from __future__ import annotations

import math

import bpy
from glow_sets import hall
from sets import ball, box, build, keyframe, lamp_and_sky, material, plain_material


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


def build_panes(scene: bpy.types.Scene, frames: int) -> None:
    """Panes of tinted film that slide over each other before a shelf, as in a paper theatre: they do not refract."""
    hall(scene, frames)
    bpy.ops.object.light_add(type="AREA", location=(1.0, -1.0, 2.9))
    bpy.context.object.data.energy, bpy.context.object.data.size = 110, 0.6
    for n in range(5):
        look = material(f"jar{n}", (0.2 + 0.12 * n, 0.3, 0.6 - 0.1 * n), (0.7, 0.7, 0.4), 6)
        box(f"jar{n}", (0.7 * n - 1.5, 2.3, 0.8 + 0.1 * (n % 3)), (0.35, 0.35, 1.6 + 0.2 * (n % 3)), look)
    for n, colour in enumerate(((1, 0.45, 0.35), (0.4, 0.75, 1), (0.95, 0.9, 0.35), (0.55, 1, 0.55))):
        pane = box(f"pane{n}", (0, 0, 0), (0.9, 0.01, 1.3), film(f"film{n}", colour))
        x, y, z, way = 0.9 * n - 1.6, 0.2 - 0.25 * n, 1.3 + 0.15 * (n % 2), 0.055 * (-1) ** n * (frames - 1)
        keyframe(pane, frames, (x - way, y, z), (x + way, y, z))


def film(name: str, colour: tuple[float, float, float]) -> bpy.types.Material:
    """A material that lets seven samples of eight through, in its colour, and mirrors the rest."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.remove(nodes["Principled BSDF"])
    clear, dull, both = (nodes.new(f"ShaderNode{kind}") for kind in ("BsdfTransparent", "BsdfGlossy", "MixShader"))
    clear.inputs["Color"].default_value, dull.inputs["Roughness"].default_value = (*colour, 1), 0.15
    both.inputs["Fac"].default_value = 0.12
    links.new(clear.outputs["BSDF"], both.inputs[1])
    links.new(dull.outputs["BSDF"], both.inputs[2])
    links.new(both.outputs["Shader"], nodes["Material Output"].inputs["Surface"])
    return made


def build_catcher(scene: bpy.types.Scene, frames: int) -> None:
    """A ball and a ring that slide over a shadow catcher before a transparent film: their shadows lie in alpha."""
    bpy.ops.mesh.primitive_plane_add(size=12)
    bpy.context.object.is_shadow_catcher = True
    patched = ball("ball", (0, 0, 0.7), 0.7, material("patches", (0.7, 0.1, 0.05), (0.9, 0.8, 0.6), 6.0, 0.25))
    keyframe(patched, frames, (-0.5, 0, 0.7), (0.4, 0, 0.7))
    bpy.ops.mesh.primitive_torus_add(major_radius=0.4, minor_radius=0.14)
    bpy.ops.object.shade_smooth()
    ring = bpy.context.object
    ring.data.materials.append(plain_material("gold", Metallic=1.0, Roughness=0.2, Base_Color=(0.9, 0.6, 0.2, 1)))
    keyframe(ring, frames, (0.9, -0.6, 0.25), (0.5, -1.0, 0.25))
    lamp_and_sky(scene)
    bpy.ops.object.camera_add(location=(0, -5, 2), rotation=(math.radians(74), 0, 0))
    scene.camera = bpy.context.object
    keyframe(scene.camera, frames, (0, -5, 2), (0.4, -4.7, 2))
    scene.render.film_transparent = True


VEIL_SETS = {
    "mist": build_mist,
    "fog": build_fog,
    "veil": build_veil,
    "panes": build_panes,
    "catcher": build_catcher,
}
