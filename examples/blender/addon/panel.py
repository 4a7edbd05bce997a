"""The panel "Denoise Animation" in the render and output properties, its settings, and the preferences."""

from __future__ import annotations

import textwrap

import bpy

from . import operators, passes, work

RELATIVE = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5) else set()
LIGHT = (
    ("BEST", "Best picture", "The whole picture, by the frames before and after each: the best look, the longest time"),
    ("PASSES", "Every light pass", "Diffuse, glossy, transmission and volume, direct and indirect, each for itself: "
     "for compositing"),
)  # fmt: skip


class RTDENOISE_Settings(bpy.types.PropertyGroup):
    """Stored with the scene."""

    samples: bpy.props.IntProperty(name="Samples", description="Per pixel, instead of the scene's", default=4, min=1)
    light: bpy.props.EnumProperty(name="Light", items=LIGHT, default="BEST")
    also: bpy.props.StringProperty(
        name="Also", description="Names of light groups or other additive passes to denoise as well, e.g. Combined_key"
    )
    folder: bpy.props.StringProperty(
        name="Folder", description="Where noisy and clean frames go, a folder a scene", default="//denoised/",
        subtype="DIR_PATH", options=RELATIVE,
    )  # fmt: skip


class RTDENOISE_Preferences(bpy.types.AddonPreferences):
    """Which Python runs rtdenoise."""

    bl_idname = __package__

    python: bpy.props.StringProperty(
        name="Python", description="A Python with rtdenoise; empty: one is found or made", subtype="FILE_PATH"
    )
    torch_index: bpy.props.StringProperty(
        name="PyTorch From", default="https://download.pytorch.org/whl/cpu",
        description="pip's address of PyTorch builds: .../cpu is the smallest, .../cu126 is for NVIDIA GPUs",
    )  # fmt: skip

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.prop(self, "python")
        self.layout.prop(self, "torch_index")
        self.layout.operator("rtdenoise.environment")


class Panel:
    """The panel, wherever it is shown."""

    bl_label = "Denoise Animation"
    bl_space_type, bl_region_type = "PROPERTIES", "WINDOW"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 (as Blender wants it)

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene, settings = self.layout, context.scene, context.scene.rtdenoise
        layout.use_property_split, layout.use_property_decorate = True, False
        if operators.running is not None:
            _draw_progress(layout, operators.running)
            return
        obstacle = passes.obstacle(scene, context.view_layer)
        column = layout.column()
        column.active = not obstacle
        for name in ("samples", "light", *(("also",) if settings.light == "PASSES" else ()), "folder"):
            column.prop(settings, name)
        if obstacle:
            _sentence(layout, obstacle, "ERROR")
            return
        if off := passes.missing(context.view_layer):
            _sentence(layout, f"{len(off)} passes are off, the job switches them on: {', '.join(off[:3])} …", "INFO")
            layout.operator("rtdenoise.passes", text="Switch On Now")
        if work.blurs(context):
            _sentence(layout, "Motion blur is on: a second, short render without it tells where surfaces are", "INFO")
        layout.operator("rtdenoise.animation", icon="RENDER_ANIMATION")
        if work.can_go_on(work.folder_of(scene)):
            layout.operator("rtdenoise.animation", text="Continue", icon="PLAY").go_on = True
        if operators.message:
            _sentence(layout, operators.message, "NONE")


class RTDENOISE_PT_render(Panel, bpy.types.Panel):
    bl_context = "render"


class RTDENOISE_PT_output(Panel, bpy.types.Panel):
    bl_context = "output"


def _draw_progress(layout: bpy.types.UILayout, job) -> None:
    if hasattr(layout, "progress"):  # Blender 4.1
        layout.progress(factor=job.fraction, text=job.text)
    else:
        layout.label(text=job.text)
    layout.operator("rtdenoise.cancel", icon="CANCEL")


def _sentence(layout: bpy.types.UILayout, text: str, icon: str) -> None:
    """A sentence in lines that fit a narrow editor."""
    column = layout.column(align=True)
    for i, line in enumerate(textwrap.wrap(text[:1].upper() + text[1:], 60)):
        column.label(text=line, icon=icon if i == 0 else "BLANK1")


CLASSES = (RTDENOISE_Settings, RTDENOISE_Preferences, RTDENOISE_PT_render, RTDENOISE_PT_output)
