"""A .blend file with every setting that spoils frames for a denoiser, and one without a camera.

    python blender_spoiled.py FOLDER
"""

import sys
from pathlib import Path

import bpy

FOLDER = Path(sys.argv[1])

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.world = bpy.data.worlds.new("sky")
bpy.ops.mesh.primitive_plane_add(size=50)
bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "blind.blend"))

bpy.ops.object.camera_add(location=(0, 0, 4))
scene.camera = bpy.context.object
scene.render.resolution_x, scene.render.resolution_y = 32, 24
scene.frame_start, scene.frame_end, scene.frame_step = 1, 2, 2
scene.view_layers[0].name, scene.view_layers[0].use, scene.view_layers[0].samples = "first", False, 16
scene.view_layers.new("second")
if bpy.app.version < (4, 4):  # a strip, and a Composite node
    scene.sequence_editor_create().sequences.new_effect("red", "COLOR", 1, frame_start=1, frame_end=3)
    scene.use_nodes = True
render = scene.render
render.use_border, render.border_min_x, render.border_max_x = True, 0.3, 0.6
render.use_multiview = render.use_motion_blur = render.use_placeholder = True
render.use_overwrite = render.use_file_extension = False
scene.cycles.time_limit = 0.001
bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "spoiled.blend"))
