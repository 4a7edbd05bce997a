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
from pathlib import Path

import bpy
from glow_sets import GLOW_SETS
from lens_sets import LENS_SETS
from matter_sets import MATTER_SETS
from motion_sets import MOTION_SETS
from sets import SETS
from variety_sets import VARIETY_SETS
from veil_sets import VEIL_SETS
from water_sets import WATER_SETS

ALL_SETS = SETS | LENS_SETS | VEIL_SETS | MOTION_SETS | WATER_SETS | VARIETY_SETS | GLOW_SETS | MATTER_SETS

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


def surfaces_only(scene: bpy.types.Scene) -> None:
    """What `rtdenoise denoise --surfaces` reads: no motion blur, and little light."""
    scene.render.use_motion_blur = False
    scene.cycles.samples, scene.cycles.diffuse_bounces = 4, 0


def simulate(scene: bpy.types.Scene) -> None:
    """Run through the frames once, so that physics are in Blender's cache: motion vectors take the frame after, to
    which they would jump."""
    for number in range(scene.frame_start - 1, scene.frame_end + 2):
        scene.frame_set(number)


def own_size(scene: bpy.types.Scene) -> tuple[int, int]:
    """Width and height set in the file, in pixels."""
    render = scene.render
    return tuple(n * render.resolution_percentage // 100 for n in (render.resolution_x, render.resolution_y))


def straighten() -> None:
    """Constant speed instead of Blender's eased curves."""
    bpy.context.preferences.edit.keyframe_new_interpolation_type = "LINEAR"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder for frame.0001.exr …")
    parser.add_argument("--scene", type=Path, help="a .blend file to render instead of the room")
    parser.add_argument("--set", choices=ALL_SETS, default="room", help="what to build without --scene")
    parser.add_argument("--frames", type=int, help="default: 12, or as in the file")
    parser.add_argument("--width", type=int, help="default: 320, or as in the file")
    parser.add_argument("--height", type=int, help="default: 180, or as in the file")
    parser.add_argument("--samples", type=int, default=1, help="per pixel")
    parser.add_argument("--transparent", action="store_true", help="no sky in the picture, but alpha")
    parser.add_argument("--seed", type=int, default=1, help="of the noise: another for a reference")
    parser.add_argument("--surfaces", type=Path, help="folder for a second render without motion blur, with which "
                        "`rtdenoise denoise --surfaces` takes frames that have it: as in the file, in a --set always")
    options = parser.parse_args()

    if options.scene:
        if not options.scene.is_file():
            parser.error(f"{options.scene}: no such file")
        bpy.ops.wm.open_mainfile(filepath=str(options.scene.resolve()))
        scene = bpy.context.scene
        if scene.camera is None:
            parser.error(f"{options.scene}: the scene has no camera")
        (width, height), blurs = own_size(scene), scene.render.use_motion_blur
    else:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene, width, height, blurs = bpy.context.scene, 320, 180, True
        straighten()
        ALL_SETS[options.set](scene, options.frames or 12)
        scene.frame_start, scene.frame_end = 1, 12
    if options.frames:
        scene.frame_end = scene.frame_start + options.frames - 1
    configure(scene, options.width or width, options.height or height, options.samples, options.seed)
    add_passes(scene)
    scene.render.film_transparent |= options.transparent
    if options.scene:
        simulate(scene)
    scene.render.use_motion_blur = bool(options.surfaces) and blurs
    scene.render.filepath = str(options.out.resolve() / "frame.####")
    bpy.ops.render.render(animation=True)
    if options.surfaces:
        surfaces_only(scene)
        scene.render.filepath = str(options.surfaces.resolve() / "frame.####")
        bpy.ops.render.render(animation=True)


if __name__ == "__main__":
    main()
