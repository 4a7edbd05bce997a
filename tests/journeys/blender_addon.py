"""An artist with Blender: install the zip, build a small scene, click, look at the result in the compositor.

    python blender_addon.py ADDON.zip PYTHON FOLDER

The Python that runs this has Blender as a module (bpy); PYTHON has rtdenoise.

BLENDER_USER_RESOURCES names a folder for Blender's settings, so that nobody's own are touched.
"""

import sys
from pathlib import Path

import bpy

ZIP, PYTHON, FOLDER = sys.argv[1], sys.argv[2], Path(sys.argv[3])
NAME = "bl_ext.user_default.rtdenoise"
SIZE, FRAMES = (96, 64), 3


def fails(words, **options):
    """Click the button, and expect a sentence."""
    try:
        bpy.ops.rtdenoise.animation(**options)
    except RuntimeError as error:
        assert words in str(error) and "Traceback" not in str(error), error
        print(f"refused: {str(error).strip()}")
    else:
        raise AssertionError(f"not refused: {words}")


def build_scene(scene):
    """A monkey that turns, above a plane, before a bright sky."""
    bpy.ops.mesh.primitive_plane_add(size=8, location=(0, 0, -1))
    bpy.ops.mesh.primitive_monkey_add(size=2)
    monkey = bpy.context.object
    for frame, angle in ((0, -0.2), (FRAMES + 1, 0.6)):
        monkey.rotation_euler.z = angle
        monkey.keyframe_insert("rotation_euler", frame=frame)
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.6, 0.8, 1)
    bpy.ops.object.camera_add(location=(0, -5, 0.6), rotation=(1.45, 0, 0))
    scene.camera = bpy.context.object
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.frame_start, scene.frame_end = 1, FRAMES


def check_node(scene, frames):
    """The compositor shows the frames."""
    tree = scene.node_tree if hasattr(scene, "node_tree") and not hasattr(scene, "compositing_node_group") else None
    tree = tree or scene.compositing_node_group
    node = tree.nodes[f"Denoised {scene.name}"]
    assert node.image.source == "SEQUENCE" and node.frame_duration == FRAMES, node.image.source
    assert Path(bpy.path.abspath(node.image.filepath)) == frames[0] and tuple(node.image.size) == SIZE
    (link,) = (link for link in tree.links if link.from_node == node)
    assert link.to_node.bl_idname == "CompositorNodeViewer" and link.from_socket.name in ("Combined", "Image")
    print(f"compositor: {node.name} ({node.image.type}), {link.from_socket.name} -> {link.to_node.name}")


bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.extensions.package_install_files(filepath=ZIP, repo="user_default", enable_on_install=True)
bpy.context.preferences.addons[NAME].preferences.python = PYTHON
scene = bpy.context.scene
settings = scene.rtdenoise
settings.samples, settings.folder = 1, "//denoised/"

scene.render.engine = "BLENDER_WORKBENCH"
fails("Set Render Engine to Cycles")
scene.render.engine = "CYCLES"
fails("Save the .blend file first")
bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "film.blend"))
fails("Add a camera")
build_scene(scene)
fails("holds no cancelled job", go_on=True)
bpy.context.preferences.addons[NAME].preferences.python = str(FOLDER / "nothing")
fails("is no file")
bpy.context.preferences.addons[NAME].preferences.python = PYTHON

for light in ("PASSES", "BEST"):
    settings.light = light
    assert bpy.ops.rtdenoise.animation() == {"FINISHED"}
    job = FOLDER / "denoised" / "Scene"
    noisy, clean = (sorted((job / name).glob("frame.*.exr")) for name in ("noisy", "clean"))
    assert [path.name for path in noisy] == [path.name for path in clean] == [f"frame.000{i}.exr" for i in (1, 2, 3)]
    assert not (job / "job.blend").exists() and scene.view_layers[0].use_pass_vector
    print(f"{light}: {len(clean)} frames")
    check_node(scene, clean)
