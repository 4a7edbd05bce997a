"""The passes of a view layer that rtdenoise reads, and what else stands in the way of a job."""

from __future__ import annotations

import bpy

DATA = {"use_pass_combined": "Combined", "use_pass_z": "Z", "use_pass_normal": "Normal", "use_pass_vector": "Vector"}
LIGHT = {
    f"use_pass_{lobe}_{kind}": f"{lobe.title()} {kind.title()}"
    for lobe in ("diffuse", "glossy", "transmission")
    for kind in ("direct", "indirect", "color")
} | {"use_pass_emit": "Emission", "use_pass_environment": "Environment"}
CYCLES = {
    "denoising_store_passes": "Denoising Data", "use_pass_volume_direct": "Volume Direct",
    "use_pass_volume_indirect": "Volume Indirect",
}  # fmt: skip


LONGEST = 45  # bytes of a view layer's name before Blender 5, so that "Denoising Normal.X" fits behind it


def missing(layer: bpy.types.ViewLayer) -> list[str]:
    """The names of the passes that are off."""
    off = [name for key, name in (DATA | LIGHT).items() if not getattr(layer, key)]
    return off + [name for key, name in CYCLES.items() if not getattr(layer.cycles, key)]


def switch_on(layer: bpy.types.ViewLayer) -> None:
    """Switch all of them on."""
    for key in DATA | LIGHT:
        setattr(layer, key, True)
    for key in CYCLES:
        setattr(layer.cycles, key, True)


def obstacle(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> str:
    """Why this view layer cannot be rendered for rtdenoise, and what to do; "" if it can."""
    if scene.render.engine != "CYCLES":
        return "Set Render Engine to Cycles: other engines write no motion vectors and light passes"
    if not bpy.data.filepath:
        return "Save the .blend file first: the frames go into a folder beside it"
    if scene.camera is None:
        return "Add a camera: the scene has none"
    if scene.frame_step != 1:
        return "Set the frame step to 1: the denoiser looks from each frame to the one before"
    if bpy.app.version < (5, 0) and len(layer.name.encode()) > LONGEST:
        return f"Give the view layer a name of at most {LONGEST} letters: this Blender cuts longer names short"
    return ""
