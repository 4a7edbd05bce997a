"""Run by another Blender in the background: render the frames of a job that are not there yet.

    blender --background job.blend --python render_frames.py -- job.json
    python render_frames.py job.blend -- job.json                              # with Blender as a Python module

A frame gets its name when it is complete, so a job that was stopped leaves no half files and can go on.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
import passes

PHYSICS = {"CLOTH", "DYNAMIC_PAINT", "FLUID", "PARTICLE_SYSTEM", "SOFT_BODY"}  # modifiers


def configure(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, samples: int) -> None:
    """Noise that a temporal denoiser can use, in one multilayer file a frame."""
    passes.switch_on(layer)
    for other in scene.view_layers:
        other.use = other == layer
    render, cycles = scene.render, scene.cycles
    render.use_compositing = render.use_sequencer = render.use_border = render.use_multiview = False
    render.use_persistent_data = True
    cycles.samples, cycles.time_limit, layer.samples = samples, 0, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.use_animated_seed = True
    settings = render.image_settings
    if hasattr(settings, "media_type"):  # Blender 5
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth, settings.exr_codec = "OPEN_EXR_MULTILAYER", "16", "ZIP"


def render_frame(scene: bpy.types.Scene, out: Path, number: int) -> None:
    """Render a frame unless it is there."""
    final, unfinished = out / f"frame.{number:04d}.exr", out / "unfinished.exr"
    if not final.exists():
        scene.frame_set(number)
        scene.render.filepath = str(unfinished)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        os.replace(unfinished, final)


def render_surfaces(scene: bpy.types.Scene, out: Path, number: int) -> None:
    """Render a frame without motion blur, with which Cycles writes no vectors, or zeros, and with little light."""
    render, cycles = scene.render, scene.cycles
    before = cycles.samples, cycles.diffuse_bounces
    render.use_motion_blur, (cycles.samples, cycles.diffuse_bounces) = False, (max(4, cycles.samples), 0)
    render_frame(scene, out, number)
    render.use_motion_blur, (cycles.samples, cycles.diffuse_bounces) = True, before


def simulate(scene: bpy.types.Scene, first: int, last: int) -> None:
    """Run through the frames once where there are physics, so that all find them in Blender's cache: motion vectors
    take the frame after, and a frame that is there is not rendered, both of which physics would jump over."""
    if scene.rigidbody_world or any(is_simulated(m) for item in bpy.data.objects for m in item.modifiers):
        for number in range(first - 1, last + 2):
            scene.frame_set(number)


def is_simulated(modifier: bpy.types.Modifier) -> bool:
    """Whether a modifier goes on from frame to frame."""
    return modifier.type in PHYSICS or (modifier.type == "NODES" and len(modifier.bakes) > 0)


def find_bakes(source: Path) -> None:
    """Let geometry nodes find what they have baked beside the .blend file, in the folder `source`."""
    for item in bpy.data.objects:
        for modifier in item.modifiers if item.library is None else ():
            if modifier.type == "NODES":
                modifier.bake_directory = absolute(modifier.bake_directory, source)
                for bake in modifier.bakes:
                    bake.directory = absolute(bake.directory, source)


def absolute(path: str, source: Path) -> str:
    """A path of Blender's, where it began with // for `source`."""
    return str(source / path[2:]) if path.startswith("//") else path


def main() -> None:
    before, _, (file, *_) = (sys.argv[1:], 0, sys.argv[sys.argv.index("--") + 1 :])
    if not bpy.data.filepath:
        bpy.ops.wm.open_mainfile(filepath=before[0])
    job = json.loads(Path(file).read_text(encoding="utf-8"))
    scene, out, surfaces = bpy.data.scenes[job["scene"]], Path(job["noisy"]), job.get("surfaces")
    scene.render.use_motion_blur = bool(surfaces)
    for folder in filter(None, (out, surfaces)):
        Path(folder).mkdir(parents=True, exist_ok=True)
    configure(scene, scene.view_layers[job["view_layer"]], job["samples"])
    if job.get("source"):
        find_bakes(Path(job["source"]))
    simulate(scene, job["first"], job["last"])
    numbers = range(job["first"], job["last"] + 1)
    for done, number in enumerate(numbers):
        print(f"{done}/{len(numbers)}", flush=True)
        render_frame(scene, out, number)
        if surfaces:
            render_surfaces(scene, Path(surfaces), number)
    print(f"{len(numbers)}/{len(numbers)}", flush=True)


if __name__ == "__main__":
    main()
