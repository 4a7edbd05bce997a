"""The denoised frames in the compositor: an Image node, and a Viewer that shows it."""

from __future__ import annotations

import bpy

from .work import Work, clean_frames


def tree_of(scene: bpy.types.Scene) -> tuple[bpy.types.NodeTree, bool]:
    """The scene's compositor, made if need be, and whether it was in use before."""
    if hasattr(scene, "compositing_node_group"):  # Blender 5
        used = scene.compositing_node_group is not None
        if not used:
            scene.compositing_node_group = bpy.data.node_groups.new(scene.name, "CompositorNodeTree")
        return scene.compositing_node_group, used
    used, scene.use_nodes = scene.use_nodes, True
    return scene.node_tree, used


def insert(scene: bpy.types.Scene, work: Work) -> bpy.types.Node:
    """Put the result of a job into the compositor, or renew the node that an earlier job left there.

    Nothing that somebody has linked changes: where no Viewer is in use, one shows the picture.
    """
    frames, (tree, used), name = clean_frames(work), tree_of(scene), f"Denoised {work.scene}"
    node = tree.nodes.get(name)
    if node is None:
        node = tree.nodes.new("CompositorNodeImage")
        node.name = node.label = name
        node.location = (min((other.location.x for other in tree.nodes), default=0), _below(tree, node))
    image = node.image or bpy.data.images.load(str(frames[0]))
    image.name, image.filepath, image.source = name, str(frames[0]), "SEQUENCE"
    image.reload()
    node.image = image
    node.frame_duration, node.frame_start, node.frame_offset = len(frames), work.first, work.first - 1
    node.use_auto_refresh = True
    if image.type == "MULTILAYER" and work.view_layer in {item.identifier for item in _layers(node)}:
        node.layer = work.view_layer
    _show(tree, node, instead=not used)
    return node


def picture(node: bpy.types.Node) -> bpy.types.NodeSocket:
    """The output of the node that holds the picture."""
    return next((node.outputs[name] for name in ("Combined", "Image") if name in node.outputs), node.outputs[0])


def _layers(node: bpy.types.Node):
    try:
        return node.bl_rna.properties["layer"].enum_items
    except KeyError:
        return ()


def _show(tree: bpy.types.NodeTree, node: bpy.types.Node, instead: bool) -> None:
    """Link a Viewer to the picture; one that shows something else only where that is to be replaced."""
    viewer = next((other for other in tree.nodes if other.bl_idname == "CompositorNodeViewer"), None)
    if viewer is None:
        viewer = tree.nodes.new("CompositorNodeViewer")
        viewer.location = (node.location.x + 400, node.location.y)
    if instead or not viewer.inputs[0].is_linked:
        tree.links.new(picture(node), viewer.inputs[0])


def _below(tree: bpy.types.NodeTree, node: bpy.types.Node) -> float:
    """A place below all nodes that are there; nodes that were never drawn have no size yet."""
    return min((other.location.y - 150 - 25 * len(other.outputs) for other in tree.nodes if other != node), default=0)
