"""An artist with Blender: install the zip, build a small scene, click, cancel, continue, look into the compositor.

    python blender_addon.py ADDON.zip PYTHON FOLDER

The Python that runs this has Blender as a module (bpy); PYTHON has rtdenoise. BLENDER_USER_RESOURCES names a folder for
Blender's settings, so that nobody's own are touched.
"""

import json
import os
import sys
import threading
import time
from pathlib import Path

import bpy

ZIP, PYTHON, FOLDER = sys.argv[1], sys.argv[2], Path(sys.argv[3])
NAME = "bl_ext.user_default.rtdenoise"
SIZE, FRAMES = (96, 64), 3
JOB = FOLDER / "denoised" / "Scene"


def fails(words, operator=None, **options):
    """Click the button, and expect a sentence."""
    try:
        (operator or bpy.ops.rtdenoise.animation)(**options)
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
    if bpy.app.version < (5, 0):
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.5, 0.6, 0.8, 1)
    bpy.ops.object.camera_add(location=(0, -5, 0.6), rotation=(1.45, 0, 0))
    scene.camera = bpy.context.object
    scene.camera.data.keyframe_insert("lens", frame=1)
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.frame_start, scene.frame_end = 1, FRAMES


def frames(name):
    return sorted((JOB / name).glob("frame.*.exr"))


def cancel_after_the_first_frame(operators):
    """Click Cancel as soon as a frame is there."""
    while not frames("noisy"):
        time.sleep(0.01)
    operators.cancel()


def tree_of(scene):
    return scene.compositing_node_group if bpy.app.version >= (5, 0) else scene.node_tree


def check_viewer_stays(scene):
    """What somebody has linked to the Viewer stays linked."""
    tree = tree_of(scene)
    viewer = next(node for node in tree.nodes if node.bl_idname == "CompositorNodeViewer")
    other = tree.nodes.new("CompositorNodeRGB")
    tree.links.new(other.outputs[0], viewer.inputs[0])
    sys.modules[f"{NAME}.compositor"].insert(scene, sys.modules[f"{NAME}.work"].read(JOB))
    assert [link.from_node for link in tree.links if link.to_node == viewer] == [other]


def check_node(scene):
    """The compositor shows the frames."""
    tree = tree_of(scene)
    (node,) = (node for node in tree.nodes if node.bl_idname == "CompositorNodeImage")
    assert node.image.source == "SEQUENCE" and node.frame_duration == FRAMES and node.image.type == "MULTILAYER"
    assert Path(bpy.path.abspath(node.image.filepath)) == frames("clean")[0] and tuple(node.image.size) == SIZE
    (link,) = (link for link in tree.links if link.from_node == node)
    assert link.to_node.bl_idname == "CompositorNodeViewer" and link.from_socket.name == "Combined"
    print(f"compositor: {node.name}, {link.from_socket.name} -> {link.to_node.name}")


# Install, as by dragging the zip into the window.
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.extensions.package_install_files(filepath=ZIP, repo="user_default", enable_on_install=True)
own = bpy.context.preferences.addons[NAME].preferences
operators = sys.modules[f"{NAME}.operators"]
scene = bpy.context.scene
settings = scene.rtdenoise
settings.samples = 1

# What cannot work is refused in a sentence.
scene.render.engine = "BLENDER_WORKBENCH"
fails("Set Render Engine to Cycles")
scene.render.engine = "CYCLES"
fails("Save the .blend file first")
bpy.ops.wm.save_as_mainfile(filepath=str(FOLDER / "film.blend"))
fails("Add a camera")
build_scene(scene)
scene.frame_step = 2
fails("Set the frame step to 1")
scene.frame_step = 1
if bpy.app.version < (5, 0):
    scene.view_layers[0].name = "n" * 46
    fails("Give the view layer a name of at most 45 letters")
    scene.view_layers[0].name = "ViewLayer"
fails("Allow online access")
bpy.context.preferences.system.use_online_access = True
os.environ["PIP_NO_INDEX"] = "1"
fails("Pip found no way to the internet", bpy.ops.rtdenoise.environment)
own.python = str(FOLDER / "nothing")
fails("is no file")
own.python = sys.executable
fails("has no rtdenoise that knows")
own.python = PYTHON
fails("holds no cancelled job", go_on=True)
settings.folder = "//film.blend/frames"
fails("cannot be written to")
(FOLDER / "mine" / "Scene" / "noisy").mkdir(parents=True)
(FOLDER / "mine" / "Scene" / "noisy" / "frame.0001.exr").touch()
settings.folder = "//mine/"
fails("holds frames of something else")
settings.folder = "//denoised/"

# Every light pass; cancelled, then continued.
settings.light = "PASSES"
scene.render.use_motion_blur, scene.view_layers[0].use_motion_blur = True, False
threading.Thread(target=cancel_after_the_first_frame, args=(operators,)).start()
assert bpy.ops.rtdenoise.animation() == {"CANCELLED"}
before = {path: path.stat().st_mtime_ns for path in frames("noisy")}
left = [path.name for path in JOB.rglob("*") if path.is_file()]
print(f"cancelled: {sorted(left)}")
assert 0 < len(before) < FRAMES and set(left) == {*(path.name for path in before), "job.json", "job.blend"}
assert bpy.ops.rtdenoise.animation(go_on=True) == {"FINISHED"}
assert all(path.stat().st_mtime_ns == at for path, at in before.items())
assert scene.view_layers[0].use_pass_vector, "the scene's passes are on"

# The best picture; the node of the first job shows it.
for light in ("PASSES", "BEST"):
    if light == "BEST":
        settings.light = light
        scene.view_layers[0].use_motion_blur, scene.render.motion_blur_shutter = True, 0.8
        assert bpy.ops.rtdenoise.animation() == {"FINISHED"}
    names = [f"frame.{number:04d}.exr" for number in range(1, FRAMES + 1)]
    assert [path.name for path in frames("noisy")] == [path.name for path in frames("clean")] == names
    assert not (JOB / "job.blend").exists()
    print(f"{light}: {len(names)} frames, {operators.message}")
    check_node(scene)
    done = json.loads((JOB / "clean" / "denoise.json").read_text())
    assert done["options"]["lens"], "the camera's focal length is animated"
    assert bool(done["options"]["surfaces"]) == (light == "BEST")
    assert not any("motion is zero" in note for note in done["notes"])
    if light == "BEST":
        check_viewer_stays(scene)
        assert round(done["options"]["shutter"], 3) == 0.8
        assert [path.name for path in frames("surfaces")] == names
    os.rename(JOB / "clean" / names[0], FOLDER / f"{light.lower()}.exr")
bpy.ops.preferences.addon_disable(module=NAME)
assert not hasattr(bpy.types.Scene, "rtdenoise")
