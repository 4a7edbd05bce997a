"""Denoise Animation: render at few samples, denoise with rtdenoise, and go on in the compositor.

    process, environment    programs beside Blender; a Python with rtdenoise. Need no bpy
    passes, work            what a scene needs; a job on disk
    render_frames           the renderer's side of a job
    compositor              the result as nodes
    operators, panel        buttons and what they do
"""

from __future__ import annotations

import bpy

from . import operators, panel

CLASSES = (*panel.CLASSES, *operators.CLASSES)


@bpy.app.handlers.persistent
def cancel_before_load(*_) -> None:
    """A job belongs to the file that is open."""
    operators.cancel()


def register() -> None:
    for one in CLASSES:
        bpy.utils.register_class(one)
    bpy.types.Scene.rtdenoise = bpy.props.PointerProperty(type=panel.RTDENOISE_Settings)
    bpy.app.handlers.load_pre.append(cancel_before_load)


def unregister() -> None:
    operators.cancel()
    bpy.app.handlers.load_pre.remove(cancel_before_load)
    del bpy.types.Scene.rtdenoise
    for one in reversed(CLASSES):
        bpy.utils.unregister_class(one)
