"""A .blend file with cloth that falls below a camera, not baked, and a job that renders it.

    python blender_cloth.py FOLDER

played.json is the depth of the cloth in each frame as Blender plays it.
"""

import json
import sys
from pathlib import Path

import bpy

FOLDER, FRAMES = Path(sys.argv[1]), 8

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
bpy.ops.object.camera_add(location=(0, 0, 4))
scene.camera = bpy.context.object
bpy.ops.mesh.primitive_grid_add(size=9, x_subdivisions=6, y_subdivisions=6)
cloth = bpy.context.object
cloth.modifiers.new("Cloth", "CLOTH")
scene.render.resolution_x, scene.render.resolution_y = 32, 24
scene.frame_start, scene.frame_end = 1, FRAMES
scene.frame_set(1)
bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "cloth.blend"))

job = {"scene": scene.name, "view_layer": scene.view_layers[0].name, "samples": 1, "first": 1, "last": FRAMES,
       "noisy": str(FOLDER / "noisy")}  # fmt: skip
(FOLDER / "job.json").write_text(json.dumps(job))
depths = []
for number in range(1, FRAMES + 1):
    scene.frame_set(number)
    points = cloth.evaluated_get(bpy.context.evaluated_depsgraph_get()).data.vertices
    depths.append(4 - sum(point.co.z for point in points) / len(points))
(FOLDER / "played.json").write_text(json.dumps(depths))
